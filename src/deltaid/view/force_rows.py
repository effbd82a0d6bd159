"""Tables of constraint forces, for the terminal and for the report."""

from collections import Counter

import numpy as np

from deltaid.joint_forces.study import ForceFinding, ForceStudy
from deltaid.view.numbers import number, span, with_uncertainty
from deltaid.view.table import Table

_WORDS = {"tension": "largest force", "compression": "least force", "socket": "least margin"}
# Open entries that a sentence names.
_NAMED = 8


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
