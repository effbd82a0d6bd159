"""Verdicts on recorded velocities."""

from collections.abc import Iterator

import numpy as np

from deltaid.check.evidence import Evidence
from deltaid.check.wiring.cures import Entries, Values
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map
from deltaid.check.wiring.velocity import Rate, rates
from deltaid.model.verdict import Grade, Verdict

# Correlation above which a column is some drive's velocity, and by which another's goes better.
_TOGETHER, _BETTER = 0.9, 0.05
# A scale so far from 1 is another unit, wrong, doubtful.
_UNIT, _WRONG, _DOUBTFUL = 2.2, 1.2, 1.02
# A lag [s] is doubtful beyond this, this share of a sample and so many standard deviations.
_LAG, _OF_SAMPLE, _CERTAIN = 0.3e-3, 0.05, 6.0
_TURNING = {180 / np.pi: "degrees per second", 30 / np.pi: "rpm",
            np.pi / 180: "rad/s, and not in degrees", np.pi / 30: "rad/s, and not rpm"}  # fmt: skip
_SLIDING = {1e3: "mm/s", 1e-3: "m/s, and not in mm/s"}


def velocity_verdicts(
    evidence: Evidence, motion: Motion, map: Map, entries: Entries
) -> Iterator[Verdict]:
    """One verdict a cause; a good one if there is none."""
    plain = Map.identity(len(map.order))
    found = rates(motion, map)
    if map != plain and found:
        # What goes with the positions as mapped is mended with them.
        as_mapped = {one.drive: one for one in rates(motion, plain)}
        found = tuple(one for one in found if not _right(as_mapped.get(one.drive)))
    elif not found:
        return
    names = evidence.robot.drives
    swapped = [one for one in found if _elsewhere(one)]
    if swapped:
        yield _order(names, swapped, entries)
        return
    lost = [one for one in found if one.own <= _TOGETHER]
    own = [one for one in found if one.own > _TOGETHER]
    scaled = [one for one in own if not 1 / _DOUBTFUL < one.scale < _DOUBTFUL]
    yield from _scales(evidence, scaled, entries)
    for one in lost:
        yield _lost(names[one.drive], one)
    late = [one for one in own if _is_late(one, evidence.rows.step)]
    if late and not lost:
        yield _late(names, late, entries)
    if found and not scaled and not lost and not late:
        worst = max(found, key=lambda one: abs(one.lag))
        yield Verdict(
            "velocity",
            Grade.GOOD,
            f"recorded velocities are the derivatives of the positions: within "
            f"{max(abs(one.scale - 1) for one in found):.2g} in scale and "
            f"{1e3 * abs(worst.lag):.2g} ms in time",
            number=1e3 * worst.lag,
            unit="ms",
        )


def _right(one: Rate | None) -> bool:
    return one is not None and one.own > _TOGETHER and 1 / _WRONG < one.scale < _WRONG


def _elsewhere(one: Rate) -> bool:
    return one.nearest != one.drive and one.correlation > max(_TOGETHER, one.own + _BETTER)


def _is_late(one: Rate, step: float) -> bool:
    late = abs(one.lag)
    return late > max(_LAG, _OF_SAMPLE * step) and late > _CERTAIN * one.lag_std


def _whose(names: tuple[str, ...], found: list[Rate]) -> str:
    if len(found) == len(names):
        return ""
    return ", ".join(names[one.drive] for one in found)


def _order(names: tuple[str, ...], found: list[Rate], entries: Entries) -> Verdict:
    source = {one.nearest: one.drive for one in found}
    values: Values = {i: entries.moved("velocity", i, j) for i, j in source.items()}
    pairs = ", ".join(
        f"{entries.name('velocity', one.drive)} is that of {names[one.nearest]}" for one in found
    )
    least = min(one.correlation for one in found)
    return Verdict(
        "velocity",
        Grade.WRONG,
        f"velocity columns go with the changes of other drives' positions, by correlations of at "
        f"least {least:.3f}: {pairs}",
        _whose(names, found),
        "velocity columns are in another order than the position columns",
        "map the velocity columns in the order of the drives",
        entries.proposal({"velocity": {i: entry for i, entry in values.items() if entry}}),
        number=least,
    )


def _scales(evidence: Evidence, found: list[Rate], entries: Entries) -> Iterator[Verdict]:
    names = evidence.robot.drives
    groups: dict[tuple[str, bool], list[Rate]] = {}
    for one in found:
        linear = evidence.robot.is_linear(names[one.drive])
        groups.setdefault((_named(one.scale, linear=linear), one.scale < 0), []).append(one)
    for (name, turned), group in groups.items():
        yield _scale(names, group, name, entries, turned=turned)


def _named(scale: float, *, linear: bool) -> str:
    for factor, name in (_SLIDING if linear else _TURNING).items():
        if abs(abs(scale) / factor - 1) < 0.05:
            return name
    return ""


def _scale(
    names: tuple[str, ...], found: list[Rate], name: str, entries: Entries, *, turned: bool
) -> Verdict:
    scales = [one.scale for one in found]
    size = float(np.median(np.abs(scales)))
    whose = _whose(names, found)
    whom = f" of {whose}" if whose else ""
    seen = f"velocities{whom} are {np.median(scales):.4g} times the rate at which positions change"
    values: Values = {}
    far = max(size, 1 / size) > _UNIT
    for one in found:
        i = one.drive
        entry = entries.turned("velocity", i) if turned else {}
        if name:
            factor = min((*_TURNING, *_SLIDING), key=lambda f: abs(np.log(size / f)))
            entry |= entries.in_unit("velocity", i, 1 / factor)
        elif far:
            entry |= entries.of_motor("velocity", i, 1 / abs(one.scale))
        values[i] = entry
    if name:
        key, cause = "velocity-unit", f"velocities{whom} are in {name}"
    elif far:
        key = "velocity-unit"
        cause = f"velocities{whom} are in another unit, or those of a motor behind a gear"
    else:
        key = "velocity"
        cause = f"velocities{whom} have a wrong scale, or those of another time"
    if turned:
        key = key if name or far else "velocity"
        cause = f"velocities{whom} count the other way" + (f", and {cause}" if name or far else "")
    grade = Grade.WRONG if turned or max(size, 1 / size) > _WRONG else Grade.DOUBTFUL
    cure = "declare unit, sign and gear of the velocity columns"
    if key == "velocity" and not turned:
        cure = "leave the velocity columns out: positions are then differentiated"
    return Verdict(key, grade, seen, whose, cause, cure,
                   entries.proposal({"velocity": {i: e for i, e in values.items() if e}}),
                   number=float(np.median(scales)))  # fmt: skip


def _lost(name: str, one: Rate) -> Verdict:
    return Verdict(
        "velocity",
        Grade.DOUBTFUL,
        f"the velocity column of {name} goes with no drive's changes of position (correlation "
        f"{one.correlation:.2g})",
        name,
        "the column is of another signal, or very noisy",
        "leave the velocity columns out: positions are then differentiated",
        number=one.correlation,
    )


def _late(names: tuple[str, ...], found: list[Rate], entries: Entries) -> Verdict:
    worst = max(found, key=lambda one: abs(one.lag))
    way = "behind" if worst.lag > 0 else "ahead of"
    return Verdict(
        "velocity",
        Grade.DOUBTFUL,
        f"velocities are {1e3 * abs(worst.lag):.3g} ± {2e3 * worst.lag_std:.1g} ms {way} the "
        "changes of the positions",
        _whose(names, found),
        "the drive smooths its velocity, or logs it at another time than its position",
        "leave the velocity columns out: positions are then differentiated without delay",
        number=1e3 * worst.lag,
        unit="ms",
    )
