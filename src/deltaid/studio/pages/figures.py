"""Figures of the studio on light and dark backgrounds: curves over a common time axis, and a robot
in three dimensions that follows sliders or the dragged ball."""

import itertools
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar

import numpy as np
from nicegui import events, ui
from scipy.spatial.transform import Rotation

from deltaid.recording.contents import Contents
from deltaid.recording.mapped_columns import NEEDED_OF_DRIVES
from deltaid.studio import look
from deltaid.studio.edits import Data, named
from deltaid.studio.look import Curve, Preview, TorqueCurves
from deltaid.studio.pages import parts
from deltaid.studio.plan import Used
from deltaid.studio.session import Session
from deltaid.studio.stand import Axis, Stage, robot_at, stage
from deltaid.view import style
from deltaid.view.at_pose import View, panel
from deltaid.view.drawing import Placement

_Data = TypeVar("_Data")
Options = dict[str, Any]
Span = tuple[float, float]

# Largest number of letters of a panel's title.
_LETTERS = 26


def curves(data: Preview, time: str = "time [s]") -> Options:
    """Curves of all drives, one panel per quantity, over a common time axis."""
    titles = {
        c.quantity: f"{c.quantity} [{c.unit}]" if c.unit else c.quantity[-_LETTERS:]
        for c in data.curves
    }
    rows = {quantity: row for row, quantity in enumerate(titles, 1)}
    traces = [
        {
            "name": f"drive {curve.drive + 1}" if curve.unit else curve.name,
            "legendgroup": str(curve.drive),
            "showlegend": rows[curve.quantity] == 1 and bool(curve.unit),
            "line": {"color": style.SERIES[curve.drive % len(style.SERIES)], "width": 1},
            "row": rows[curve.quantity],
        }
        for curve in data.curves
    ]
    return _panels(list(titles.values()), data.curves, traces, time)


def compared_curves(compared: TorqueCurves, names: Sequence[str], shown: str) -> Options:
    """Torques or errors, one panel per drive; the time axes are linked.

    Args:
        compared: measured and predicted torques.
        names: of the models.
        shown: 'torques' or 'errors'.
    """
    colours = itertools.cycle(style.SERIES[1:])  # the first one resembles the measured one's
    known = {None: ("measured", style.MEASURED_LINE)} | {
        model: (name, {"color": colour, "width": 1.5})
        for model, (name, colour) in enumerate(zip(names, colours, strict=False))
    }
    curves = [curve for curve in compared.curves if curve.quantity == shown]
    traces = [
        {
            "name": known[curve.model][0],
            "legendgroup": known[curve.model][0],
            "showlegend": curve.drive == 0,
            "line": known[curve.model][1],
            "row": curve.drive + 1,
        }
        for curve in curves
    ]
    return _panels(list({c.drive: f"{c.name} [{c.unit}]" for c in curves}.values()), curves, traces)


def _panels(
    titles: Sequence[str], curves: Sequence[Curve], traces: Sequence[Options],
    time: str = "time [s]",
) -> Options:  # fmt: skip
    """Curves in panels with these titles, each with its name, line and panel."""
    plot = style.stacked(titles, height=190 * len(titles) + 60, spacing=0.04, time=time)
    for curve, trace in zip(curves, traces, strict=True):
        plot.add_scatter(x=curve.time, y=curve.values, col=1, **trace)
    plot = style.themed(plot).update_layout(
        margin={"l": 60, "r": 10, "t": 10, "b": 40},
        hovermode="x unified",
        hoversubplots="axis",
        uirevision="same",  # the view stays when more detailed curves arrive
    )
    return plot.to_plotly_json() | {"config": {"displaylogo": False}}


async def zoomable(
    label: str, read: Callable[[Span | None], Awaitable[_Data]], draw: Callable[[_Data], Options]
) -> _Data:
    """A figure that is redrawn with more detail when its time span changes; returns its data.

    Args:
        label: its content, for screen readers.
        read: reads the data of a span [s], or of all time for None.
        draw: makes the figure, with a common time axis for all panels.
    """
    with parts.waiting():
        data = await read(None)
    plot = ui.plotly(draw(data)).classes("w-full").props(f'role=img aria-label="{label}"')

    async def zoomed(event: events.GenericEventArguments) -> None:
        asked = _span(event.args)
        if asked is not False:
            plot.update_figure(draw(await read(asked)))

    plot.on("plotly_relayout", zoomed)
    return data


def _span(said: Mapping[str, Any]) -> Span | Literal[False] | None:
    """The visible time span after a change of view; False if the time axis has not changed."""
    for key, value in said.items():
        if key.startswith("xaxis") and key.endswith(".autorange"):
            return None
        if key.startswith("xaxis") and key.endswith(".range[0]"):
            return float(value), float(said[key.replace("[0]", "[1]")])
    return False


async def preview(session: Session, used: Used, mapping: Data) -> None:
    """Positions, speeds and torques over time."""
    if not mapping:
        return
    robot, said = session.place(session.plan.robot or ""), ui.label().classes("dim")
    data = await _preview_plot(session, used, look.preview, (robot, mapping))
    said.set_text(
        f"{data.seconds:.4g} s, {(data.rows - 1) / max(data.seconds, 1e-9):.4g} rows a second; "
        "angles in degrees. Do they look like what the robot did?"
    )


async def signals(
    session: Session, used: Used, contents: Contents, mapping: Data, dof: int
) -> None:
    """Recorded columns before they are mapped: proposed ones, or any other."""
    known = [c.address for c in contents.columns if c.low is not None]
    time = mapping.get("time", {}).get("column")
    time = time if time in known else None
    known = [name for name in known if name != time]
    chosen = [name for name in known if name in named(mapping, dof)]
    moving = [c.address for c in contents.columns if c.address in known and not c.is_constant]
    if len(chosen) < len(known) and any(quantity not in mapping for quantity in NEEDED_OF_DRIVES):
        chosen = [*dict.fromkeys((*chosen, *moving))][: len(NEEDED_OF_DRIVES) * dof]
    picked = ui.select(known, value=chosen, label="Signals as recorded", multiple=True)
    picked.props("use-chips").classes("w-full")

    async def draw() -> None:
        if picked.value:
            await _preview_plot(
                session, used, look.signals, (time, tuple(picked.value)), time or "row"
            )

    again = parts.redrawn(draw)
    parts.remembered(session, f"signals of {used.file}", picked)
    picked.on_value_change(again)
    await again()


async def _preview_plot(
    session: Session, used: Used, read: Callable[..., Preview], given: tuple[Any, ...],
    time: str = "time [s]",
) -> Preview:  # fmt: skip
    path = str(session.folder.path(used.file))
    return await zoomable(
        f"Preview of {used.file}",
        lambda span: session.read_cached(read, path, *given, span),
        lambda data: curves(data, time),
    )


# Colours of the background and of the workspace's edges, on light and dark pages.
_LIGHT, _DARK = ("#dfe5ea", "#66727d"), ("#2a3138", "#9aa6b0")
# three.js draws cylinders along y; members are placed along z.
_Y_TO_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


async def live(session: Session, name: str) -> None:
    """The robot, sliders for its platform, and readings of drives and limits."""
    robot, changed = session.place(name), session.stamped(name)
    with parts.waiting():
        scene = await session.read_cached(stage, robot, changed)
    _Live(session, (robot, changed), scene)


class _Live:
    def __init__(self, session: Session, robot: tuple[str, str], stage: Stage) -> None:
        self.session, self.robot, self.stage = session, robot, stage
        self.place = session.poses.get(robot, stage.home)
        self.wanted, self.shown = self.place, ()
        with ui.element("div").classes("live"):
            with ui.element("div").classes("seen"):
                self._scene()
                with ui.row().classes("dim legend"):
                    for label, color in {bar.label: bar.color for bar in stage.bars}.items():
                        with ui.row().classes("items-center no-wrap"):
                            ui.element("span").classes("swatch").style(f"background: {color}")
                            ui.label(label)
                    ui.label("Drag the ball, or turn and zoom with the mouse.")
            with ui.element("div").classes("asked"):
                ui.label("Where the platform is to be").classes("text-weight-bold")
                self.sliders = [self._slider(k, axis) for k, axis in enumerate(stage.axes)]
                ui.button("Home", on_click=lambda: self._move_to(stage.home)).props("outline dense")
                self.readings = ui.html(sanitize=False).props("role=status")
        ui.timer(parts.REDRAW, self._go)

    def _scene(self) -> None:
        size = self.stage.size
        ground, edges = _DARK if self.session.dark else _LIGHT
        self.scene = ui.scene(
            height=440, grid=False, background_color=ground, click_events=[],
            on_drag_end=lambda event: self._move_to((event.x, event.y, event.z, *self.wanted[3:])),
        ).classes("w-full")  # fmt: skip
        self.scene.props('role=img aria-label="The robot, in three dimensions"')
        with self.scene:
            for start, end in self.stage.edges:
                self.scene.line(start.tolist(), end.tolist()).material(edges)
            radii = [body.radius(size) for body in self.stage.bars]
            self.bars = [
                self.scene.cylinder(radius, radius, 1, 12).material(body.color)
                for body, radius in zip(self.stage.bars, radii, strict=True)
            ]
            self.ball = self.scene.sphere(0.022 * size).material("#e8a200").draggable()
        middle = np.array(self.stage.home[:3]) * [1, 1, 0.55]
        eye = middle + size * np.array([1.0, 0.78, 0.25])
        self.scene.move_camera(*eye.tolist(), *middle.tolist(), duration=0)

    def _slider(self, k: int, axis: Axis) -> Any:
        def ask(event: events.ValueChangeEventArguments[float | None]) -> None:
            asked = self.stage.home[k] if event.value is None else event.value
            value.set_text(_text(asked, axis))
            if abs(asked - self.wanted[k]) > 1e-9:
                self.wanted = tuple(asked if i == k else w for i, w in enumerate(self.wanted))

        with ui.row().classes("items-center w-full no-wrap"):
            ui.label(axis.name).classes("w-4")
            slider = ui.slider(
                min=axis.low, max=axis.high, step=(axis.high - axis.low) / 200, value=self.place[k]
            )
            slider.props(f'aria-label="platform {axis.name} [{axis.unit}]"').classes("grow")
            value = ui.label(_text(self.place[k], axis)).classes("number")
            slider.on_value_change(ask)
        return slider

    def _move_to(self, wanted: tuple[float, ...]) -> None:
        """Request a pose that no slider requested; the sliders follow."""
        self.wanted = wanted
        for slider, value in zip(self.sliders, wanted, strict=True):
            slider.set_value(value)

    async def _go(self) -> None:
        """Move the robot to the last requested pose."""
        if self.shown != self.wanted:
            self.shown = self.wanted
            self._draw(*await self.session.read(robot_at, *self.robot, self.wanted, self.place))

    def _draw(self, view: View, placed: Placement) -> None:
        units = np.array([1.0 if axis.unit == "m" else np.rad2deg(1.0) for axis in self.stage.axes])
        self.place = tuple((view.z * units).tolist())
        self.session.poses = {self.robot: self.place}
        turns = Rotation.from_quat(placed.wxyz[:, [1, 2, 3, 0]]).as_matrix() @ _Y_TO_Z
        for k, bar in enumerate(self.bars):
            bar.move(*placed.positions[k].tolist())
            bar.rotate_R(turns[k].tolist())
            bar.scale(1.0, float(placed.scales[k, 2]), 1.0)
        self.ball.move(*self.place[:3])
        self.readings.set_content(panel(view))


def _text(value: float, axis: Axis) -> str:
    return f"{value:.3f} m" if axis.unit == "m" else f"{value:.1f}°"
