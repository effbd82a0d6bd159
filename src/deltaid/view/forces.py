"""The page of `deltaid forces`: forces along the struts, worst cases, and their uncertainty."""

from collections import Counter

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.errors import few
from deltaid.joint_forces.forces import ALONG, ForceFinding, Forces
from deltaid.view import style
from deltaid.view.comparison import POINTS, extreme_rows, stretch_length
from deltaid.view.corrections import correction_section
from deltaid.view.drawing import drawing
from deltaid.view.models import warned
from deltaid.view.numbers import measured, number, span, with_uncertainty
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card
from deltaid.view.summary import provenance_section

_WORDS = {"tension": "largest force", "compression": "least force", "socket": "least margin"}
# Largest number of undetermined entries in a sentence.
_NAMED = 8


def forces_card(value: Forces) -> Card:
    said, robot, warnings = verdict(value), value.model.robot, warned(value.warnings)
    return Card(
        f"Forces of {robot.label} along {value.recording.path.name}",
        (said.sentence, what_is_open(value)),
        said.grade,
        table=tables(value)[0],
        more=warnings,
        prompt_lines=tuple(title for title, _ in warnings),
        methods=(
            *(".findings", ".warnings", ".plot()", ".to_frame()"),
            *('.save("x.csv")', '.report("x.html")'),
        ),
    )


def forces_frame(value: Forces) -> pl.DataFrame:
    """Forces over time: t and one column per channel."""
    return pl.concat(value.tables())


def forces_figure(value: Forces) -> go.Figure:
    return _over_time(value).figure


def forces_page(value: Forces) -> Page:
    model, forces = value.model, value.constraint_forces
    *along, loads = tables(value)
    return Page(
        title=model.robot.label,
        subtitle=f"Constraint forces along {value.recording.path.name}, parameters: {model.origin}",
        drawing=drawing(model.robot, model.dynamics.kinematics),
        verdict=verdict(value),
        facts=_facts(value),
        sections=(
            Section(
                "Along the struts",
                (_over_time(value),),
                "tension and compression over time",
                unfolded=True,
            ),
            Section(
                "Worst cases",
                (*along, Text(f"{what_is_open(value)}.")),
                "the largest and least force of each strut, and how sure",
                unfolded=True,
            ),
            Section(
                "Other joints, and where",
                (loads, places(value)),
                "loads of motors and telescope, and where the platform is in the worst cases",
            ),
            correction_section(model.identified),
            provenance_section(model, "The model"),
        ),
        warnings=(forces.note,) if forces.note else (),
    )


def verdict(study: Forces) -> Summary:
    """Range of the forces along the struts, and whether ball joints stay closed."""
    along = [f.worst.value for kind in ALONG for f in _findings(study, kind)]
    least, most = (f"{measured(bound(along))} N" for bound in (min, max))
    said = f"forces along the struts reach from {least} to {most} (tension is positive)"
    if (socket_force := study.constraint_forces.socket_force) is None:
        line = "No springs of ball joints are described, so nothing is said of their margins."
        return Summary(Trust.UNTESTED, f"{said[0].upper()}{said[1:]}.", (line,))
    margin = min(f.worst.value for f in _findings(study, "socket")) + socket_force
    if margin <= 0:
        return Summary(Trust.POOR, f"Poor: a ball joint comes apart; {said}.")
    left = f"with {measured(margin)} N left"
    return Summary(Trust.GOOD, f"Good: all ball joints hold, {left}; {said}.")


def _facts(study: Forces) -> tuple[Fact, ...]:
    socket_force = study.constraint_forces.socket_force
    kinds = {"tension": ("largest tension", 0.0), "compression": ("least force", 0.0)}
    if socket_force is not None:
        kinds["socket"] = "least margin of a ball joint", socket_force
    facts = []
    for kind, (label, offset) in kinds.items():
        every = sorted((f.worst for f in _findings(study, kind)), key=lambda worst: worst.value)
        worst = every[-1 if kind == "tension" else 0]
        value = f"{measured(worst.value + offset)} {worst.unit}"
        facts.append(Fact(label, value, f"{worst.part} at {worst.at.time:.3f} s"))
    return tuple(facts)


def _envelope(study: Forces) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest force along every strut in stretches of equal length, in constant memory.

    Times and forces of these samples, in order of time, one column per strut.
    """
    forces, times, pairs = study.constraint_forces, list[np.ndarray](), list[np.ndarray]()
    channels = [forces.index(f"{strut}.platform.x") for strut in forces.struts]
    length = stretch_length(2 * study.recording.log.samples, POINTS)
    for motion, values in study.over_time():
        rows = np.column_stack([extreme_rows(values[:, k], length) for k in channels])
        times.append(motion.time[rows])
        pairs.append(np.take_along_axis(values[:, channels], rows, axis=0))
    return np.concatenate(times), np.concatenate(pairs)


def _over_time(study: Forces) -> Figure:
    forces, (time, along) = study.constraint_forces, _envelope(study)
    limbs = len(forces.robot.limb_geometry)
    titles, each = [f"limb {row + 1} [N]" for row in range(limbs)], len(forces.struts) // limbs
    figure = style.stacked(titles, height=200 * limbs + 60, spacing=0.03)
    for k, strut in enumerate(forces.struts):
        figure.add_scatter(
            x=time[:, k].astype(np.float32),
            y=along[:, k].astype(np.float32),
            name=strut,
            showlegend=each > 1,  # the axis names a single strut
            mode="lines",
            line={"color": style.SERIES[k % each], "width": 1.2},
            hovertemplate=f"{strut} %{{y:.4g}} N at %{{x:.4g}} s<extra></extra>",
            row=k // each + 1,
            col=1,
        )
    return Figure(
        figure,
        "Force along the struts at the platform; tension is positive. In long recordings each "
        "stretch is shown by its least and its largest force.",
        paper=460,
    )


def tables(study: Forces) -> tuple[Table, ...]:
    """Forces along struts, margins of sockets if they have springs, loads of other joints."""
    how, force = "range" if _with_ranges(study) else "± open", study.constraint_forces.socket_force
    pairs = zip(*(_findings(study, kind) for kind in ALONG), strict=True)
    struts = _titled(
        "force along the struts, N; tension is positive",
        ("strut", "largest", how, "at, s", "least", how, "at, s"),
        [(most.worst.part, *_cells(most), *_cells(least)) for most, least in pairs],
    )
    loads = _titled(
        "loads of the other joints, each where its size is largest",
        ("load", "unit", "largest", how, "at, s"),
        [(f.worst.part, f.worst.unit, *_cells(f)) for f in _findings(study, "load")],
    )
    if force is None:
        return struts, loads
    sockets = _titled(
        f"margin of the ball joints, N; springs hold them with {number(force)} N",
        ("strut", "at the", "least margin", how, "at, s"),
        [
            (f.worst.part, f.worst.channel.split(".")[1], *_cells(f, force))
            for f in _findings(study, "socket")
        ],
    )
    return struts, sockets, loads


def _with_ranges(study: Forces) -> bool:
    return any(f.range for f in study.findings)


def _titled(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    return Table(columns, tuple(rows), f"{title}.", title=title)


def places(study: Forces) -> Table:
    """Pose of the platform at the worst forces along struts and at the least margins."""
    worst = [finding.worst for kind in _WORDS for finding in _findings(study, kind)]
    rows = [
        (
            w.part,
            _WORDS[w.kind],
            f"{w.at.time:.3f}",
            *(f"{value:.4f}" for value in w.at.z[:3]),
            *(f"{value:.2f}" for value in np.degrees(w.at.z[3:])),
        )
        for w in worst
    ]
    coordinates = ("x, m", "y, m", "z, m", "ψ, deg")[: len(worst[0].at.z)]
    return _titled("where the platform is then", ("strut", "worst", "at, s", *coordinates), rows)


def what_is_open(study: Forces) -> str:
    """A sentence on the uncertainty columns, with the undetermined entries that most forces depend
    on."""
    counts = Counter(name for f in study.findings for name in f.openness.unknowns)
    entries = [name for name, _ in counts.most_common()]
    names = few(entries, _NAMED) or "nothing"
    if _with_ranges(study):
        return (
            "range: what agrees with the recordings (95 %), and with the prior in what torques "
            f"leave open, which here is {names}"
        )
    return (
        "± open: how far the prior leaves a force open that no torque decides (95 %), 0 where "
        f"torques do; it comes from {names}. Ranges need the recordings (--logs)"
    )


def _findings(study: Forces, kind: str) -> list[ForceFinding]:
    return [finding for finding in study.findings if finding.worst.kind == kind]


def _cells(finding: ForceFinding, offset: float = 0.0) -> tuple[str, str, str]:
    value, time = finding.worst.value + offset, f"{finding.worst.at.time:.3f}"
    if finding.range is not None:
        return number(value), span(finding.range.low + offset, finding.range.high + offset), time
    shown, half = with_uncertainty(value, finding.openness.half_width)
    return shown, half or "0", time
