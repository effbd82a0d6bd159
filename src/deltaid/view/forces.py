"""The page of `deltaid forces`: forces along the struts, worst cases, what is known."""

from collections import Counter

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from plotly.subplots import make_subplots

from deltaid.joint_forces.constraint_forces import ConstraintForces, Motion
from deltaid.joint_forces.study import ForceFinding, ForceStudy
from deltaid.model.model import ModelLike, load
from deltaid.view import style
from deltaid.view.corrections import put_right_sections
from deltaid.view.drawing import drawing
from deltaid.view.numbers import measured, number, span, with_uncertainty
from deltaid.view.page import Fact, Figure, Page, Section, Text
from deltaid.view.provenance import provenance_section
from deltaid.view.summary import Grade, Summary
from deltaid.view.table import Table

# Stretches that a figure shows, each by its least and its largest force.
_STRETCHES = 1500
_WORDS = {"tension": "largest force", "compression": "least force", "socket": "least margin"}
# Open entries that a sentence names.
_NAMED = 8


class Envelope:
    """Least and largest force along every strut in stretches of equal length; constant memory."""

    def __init__(self, forces: ConstraintForces, samples: int) -> None:
        self._length = max(1, -(-samples // _STRETCHES))
        self._at = [forces.index(f"{strut}.platform.x") for strut in forces.struts]
        self._time: list[np.ndarray] = []
        self._force: list[np.ndarray] = []

    def add(self, motion: Motion, values: Float[np.ndarray, "samples channels"]) -> None:
        """Take in consecutive samples."""
        starts = np.arange(0, len(motion.time), self._length)
        along = values[:, self._at]
        least = np.minimum.reduceat(along, starts, axis=0)
        most = np.maximum.reduceat(along, starts, axis=0)
        self._time.append(np.repeat(motion.time[starts], 2))
        pairs = np.stack([least, most], axis=1)
        self._force.append(pairs.reshape(-1, along.shape[1]))

    def curves(self) -> tuple[np.ndarray, np.ndarray]:
        """Time, each twice, and forces, least and largest in turn."""
        return np.concatenate(self._time), np.concatenate(self._force)


def forces_page(
    model: ModelLike, forces: ConstraintForces, name: str, study: ForceStudy, envelope: Envelope
) -> Page:
    """Everything about the forces of a model along a motion."""
    model = load(model)

    *along, loads = tables(study, forces.socket_force)
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Constraint forces along {name}, parameters: {model.origin}",
        drawing=drawing(model.robot, model.dynamics.kinematics),
        verdict=_verdict(study, forces.socket_force),
        facts=_facts(study, forces.socket_force),
        sections=(
            Section(
                "Along the struts",
                (_over_time(forces, envelope),),
                "tension and compression over time",
                unfolded=True,
            ),
            Section(
                "Worst cases",
                (*along, Text(f"{what_is_open(study)}.")),
                "the largest and least force of each strut, and how sure",
                unfolded=True,
            ),
            Section(
                "Other joints, and where",
                (loads, places(study)),
                "loads of motors and telescope, and where the platform is in the worst cases",
            ),
            *put_right_sections(model.identified),
            provenance_section(model, "The model"),
        ),
        warnings=(forces.note,) if forces.note else (),
    )


def _verdict(study: ForceStudy, socket_force: float | None) -> Summary:
    """How far forces reach along the struts, and whether ball joints hold."""
    along = [f.worst.value for f in study.findings if f.worst.kind in ("tension", "compression")]
    least, most = (f"{measured(one(along))} N" for one in (min, max))
    said = f"forces along the struts reach from {least} to {most} (tension is positive)"
    if socket_force is None:
        line = "No springs of ball joints are described, so nothing is said of their margins."
        return Summary(Grade.UNTESTED, f"{said[0].upper()}{said[1:]}.", (line,))
    margin = min(f.worst.value for f in study.findings if f.worst.kind == "socket") + socket_force
    if margin <= 0:
        return Summary(Grade.POOR, f"Poor: a ball joint comes apart; {said}.")
    return Summary(
        Grade.GOOD, f"Good: all ball joints hold, with {measured(margin)} N left; {said}."
    )


def _facts(study: ForceStudy, socket_force: float | None) -> tuple[Fact, ...]:
    def fact(label: str, kind: str, offset: float = 0.0, *, most: bool = False) -> Fact:
        every = [f.worst for f in study.findings if f.worst.kind == kind]
        worst = (max if most else min)(every, key=lambda w: w.value)
        return Fact(
            label,
            f"{measured(worst.value + offset)} {worst.unit}",
            f"{worst.part} at {worst.at.time:.3f} s",
        )

    facts = [fact("largest tension", "tension", most=True), fact("least force", "compression")]
    if socket_force is not None:
        facts.append(fact("least margin of a ball joint", "socket", socket_force))
    return tuple(facts)


def _over_time(forces: ConstraintForces, envelope: Envelope) -> Figure:
    time, along = envelope.curves()
    limbs = len(forces.robot.limb_geometry)
    each = len(forces.struts) // limbs
    figure = make_subplots(rows=limbs, cols=1, shared_xaxes=True, vertical_spacing=0.03)
    for k, strut in enumerate(forces.struts):
        row = k // each + 1
        figure.add_trace(
            go.Scatter(
                x=time.astype(np.float32),
                y=along[:, k].astype(np.float32),
                name=strut,
                showlegend=each > 1,  # where there is one, the axis names its limb
                mode="lines",
                line={"color": style.SERIES[k % each], "width": 1.2},
                hovertemplate=f"{strut} %{{y:.4g}} N at %{{x:.4g}} s<extra></extra>",
            ),
            row=row,
            col=1,
        )
        figure.update_yaxes(title_text=f"limb {row} [N]", row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=limbs, col=1)
    figure.update_layout(height=200 * limbs + 60)
    return Figure(
        figure,
        "Force along the struts at the platform; tension is positive. In long recordings each "
        "stretch is shown by its least and its largest force.",
        paper=460,
    )


def tables(study: ForceStudy, socket_force: float | None) -> tuple[Table, ...]:
    """Forces along struts, margins of sockets if there are any, loads of other joints."""
    found = [_struts(study)]
    if socket_force is not None:
        found.append(_sockets(study, socket_force))
    return (*found, _loads(study))


def _titled(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    return Table(columns, tuple(rows), f"{title}.", title=title)


def _struts(study: ForceStudy) -> Table:
    tension, compression = _of(study, "tension"), _of(study, "compression")
    rows = [
        (most.worst.part, *_cells(most), *_cells(least))
        for most, least in zip(tension, compression, strict=True)
    ]
    how = _heading(study)
    columns = ("strut", "largest", how, "at, s", "least", how, "at, s")
    return _titled("force along the struts, N; tension is positive", columns, rows)


def _sockets(study: ForceStudy, socket_force: float) -> Table:
    rows = []
    for finding in _of(study, "socket"):
        end = finding.worst.channel.split(".")[1]
        rows.append((finding.worst.part, end, *_cells(finding, socket_force)))
    columns = ("strut", "at the", "least margin", _heading(study), "at, s")
    title = f"margin of the ball joints, N; springs hold them with {number(socket_force)} N"
    return _titled(title, columns, rows)


def _loads(study: ForceStudy) -> Table:
    rows = [(f.worst.part, f.worst.unit, *_cells(f)) for f in _of(study, "load")]
    columns = ("load", "unit", "largest", _heading(study), "at, s")
    return _titled("loads of the other joints, each where its size is largest", columns, rows)


def places(study: ForceStudy) -> Table:
    """Where the platform is when forces along struts and margins are worst."""
    found = [f.worst for kind in ("tension", "compression", "socket") for f in _of(study, kind)]
    coordinates = ("x, m", "y, m", "z, m", "ψ, deg")[: len(found[0].at.z)]
    rows = [
        (
            w.part,
            _WORDS[w.kind],
            f"{w.at.time:.3f}",
            *(f"{value:.4f}" for value in w.at.z[:3]),
            *(f"{value:.2f}" for value in np.degrees(w.at.z[3:])),
        )
        for w in found
    ]
    columns = ("strut", "worst", "at, s", *coordinates)
    return _titled("where the platform is then", columns, rows)


def open_entries(study: ForceStudy) -> tuple[str, ...]:
    """Entries that torques leave open and that the forces depend on, those of most forces first."""
    counts = Counter(name for f in study.findings for name in f.openness.unknowns)
    return tuple(name for name, _ in counts.most_common())


def what_is_open(study: ForceStudy) -> str:
    """A sentence on what the second column of each value means."""
    entries = open_entries(study)
    names = ", ".join(entries[:_NAMED]) or "nothing"
    if len(entries) > _NAMED:
        names += f" and {len(entries) - _NAMED} more"
    if any(f.range for f in study.findings):
        return (
            "range: what agrees with the recordings (95 %), and with the prior in what torques "
            f"leave open, which here is {names}"
        )
    return (
        "± open: how far the prior leaves a force open that no torque decides (95 %), 0 where "
        f"torques do; it comes from {names}. Ranges need the recordings (--logs)"
    )


def _of(study: ForceStudy, kind: str) -> list[ForceFinding]:
    return [finding for finding in study.findings if finding.worst.kind == kind]


def _heading(study: ForceStudy) -> str:
    return "range" if any(f.range for f in study.findings) else "± open"


def _cells(finding: ForceFinding, offset: float = 0.0) -> tuple[str, str, str]:
    """Value, range or openness, time."""
    value, time = finding.worst.value + offset, f"{finding.worst.at.time:.3f}"
    if finding.range is not None:
        known = span(finding.range.low + offset, finding.range.high + offset)
        return number(value), known, time
    shown, half = with_uncertainty(value, finding.openness.half_width)
    return shown, half or "0", time
