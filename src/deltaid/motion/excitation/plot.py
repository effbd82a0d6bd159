"""A picture of an excitation run: path, drives and torques over time with their limits."""

from importlib.util import find_spec
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from deltaid.errors import DeltaidError
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.run import Run
from deltaid.robot.parameter import JointUnits

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Samples of a curve; a picture is not wider.
SAMPLES = 2000


def require_matplotlib() -> None:
    """Find out before a long computation whether a picture can be drawn.

    Raises:
        DeltaidError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise DeltaidError(
            "the picture needs matplotlib, which is not installed",
            where="--plot",
            cure="pip install matplotlib; --report needs nothing more",
        )


def plot_run(exciter: Exciter, run: Run, file_format: str) -> bytes:
    """The picture as PNG or SVG.

    Path of the platform from above and from the side, and for each drive angle, speed and predicted
    torque; dotted lines are the ends of the ramps.

    Raises:
        DeltaidError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    robot, figure = exciter.dynamics.robot, Figure(figsize=(11, 8), layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subfigures(1, 2, width_ratios=(1, 2))
    time, units = np.linspace(0, run.duration, SAMPLES), robot.drive_units
    z, zd, zdd = run.evaluate(time)
    q, qd, _ = exciter.dynamics.kinematics.drive_motion(z, zd, zdd)
    _draw_path(panels[0].subplots(2, 1), z)
    shown = np.array([u.per_shown for u in units.values()])
    rows = (q * shown, qd * shown, exciter.preview(run, SAMPLES))
    labels = ("{0.motion} [{0.shown}]", "speed [{0.shown}/s]", "{0.effort}, predicted [{0.force}]")
    axes = panels[1].subplots(3, 1, sharex=True)
    for axis, values, label in zip(axes, rows, labels, strict=True):
        _draw_drives(axis, time, values, units, label)
        for edge in (run.ramp, run.duration - run.ramp):
            axis.axvline(edge, color="0.6", linewidth=0.8, linestyle=":")
    axes[0].legend(loc="upper right", ncols=len(robot.drives), fontsize="small")
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(robot.label)
    buffer = BytesIO()
    figure.savefig(buffer, format=file_format, dpi=150)
    return buffer.getvalue()


def _draw_path(axes: Any, z: np.ndarray) -> None:
    for axis, (i, j), labels in zip(axes, ((0, 1), (0, 2)), (("x", "y"), ("x", "z")), strict=True):
        axis.plot(z[:, i], z[:, j], linewidth=0.8)
        axis.plot(z[0, i], z[0, j], "o", markersize=4, label="start")
        axis.set(xlabel=f"{labels[0]} [m]", ylabel=f"{labels[1]} [m]", aspect="equal")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize="small")


def _draw_drives(
    axis: "Axes", time: np.ndarray, values: np.ndarray, drives: dict[str, JointUnits], label: str
) -> None:
    """All drives in one plot; one of another size or unit gets an axis of its own."""
    sizes, first = np.abs(values).max(axis=0), next(iter(drives.values()))
    axis.set_ylabel(label.format(first))
    for i, (drive, units) in enumerate(drives.items()):
        shown, color = (time, values[:, i]), f"C{i}"
        if not 0.2 <= sizes[i] / np.median(sizes) <= 5 or units != first:
            twin = axis.twinx()
            twin.set_ylabel(label.format(units), color=color)
            twin.plot(*shown, color=color, linewidth=0.9)
            twin.tick_params(axis="y", colors=color)
            drive, shown = f"{drive} (right)", ([], [])
        axis.plot(*shown, color=color, linewidth=0.9, label=drive)
    axis.grid(alpha=0.3)
