"""Verdicts on zeros of drives and the direction of gravity."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deltaid.check.evidence import Evidence
from deltaid.check.wiring.candidate import CLOSED, Candidate, assigned
from deltaid.check.wiring.cures import Entries
from deltaid.check.wiring.homing import Shifts, across, shifts
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import residual
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed

# Standard deviations from zero that are said, and beside which another cause is not needed.
_SEEN, _NEEDED = 4.2, 3.5
# Share of what is unexplained that they explain: below it something else is to be looked for.
_LITTLE = 0.005
# Share of what one drive's zero explains that another's has to.
_RIVAL = 0.7
# Difference of shares that noise makes, times the number of rows, and a factor between those of
# causes that are alike.
_CHANCE, _MORE = 6.0, 1.05
# Errors of zeros [rad or m] that slopes tell, and standard deviations of what does not show.
_FARTHEST, _VAGUE = 0.5, 0.05
# Gauss–Newton steps for a zero.
_STEPS = 3


def zero_verdicts(
    evidence: Evidence, motion: Motion, best: Candidate, entries: Entries
) -> Iterator[Verdict]:
    """Homing, tilt, one of both, or neither."""
    told = shifts(evidence.dynamics, motion, best)
    drives = _shown(told)
    closes = best.residual.poses.share >= CLOSED
    if not drives:
        if not closes:
            yield _open(best)
        return
    one = max(drives, key=lambda i: told.gain([i]))
    if not seen(told):
        if closes:
            yield _good(evidence, told)
        else:
            yield _open(best)
        return
    if _better_explained(told, one, np.flatnonzero(best.loose).tolist()):
        if not closes:
            yield _open(best)
        return
    beside = _sure(told, [one], told.tilt)
    instead = _sure(told, told.tilt, [one]) if told.tilt else 0.0
    grade = Grade.DOUBTFUL if closes else Grade.WRONG
    # Zeros of several drives mimic any tilt, so the simpler of both is said where both are left.
    either = (instead < _NEEDED) == (beside < _NEEDED)
    zero = told.gain([one]) > told.gain(told.tilt) if either and told.tilt else beside >= _NEEDED
    rivals = [one, *(i for i in drives if i != one and _rival(told, one, i))]
    way = _zero(evidence, motion, best, told, one)
    yield _verdict(evidence, told, entries, rivals, way, grade=grade, zero=zero, either=either)


def seen(told: Shifts) -> bool:
    """Whether the zero that explains most, or a tilt, is there beyond doubt and explains enough."""
    causes = _causes(told)
    sure = max((_sure(told, which) for which in causes), default=0.0)
    return sure >= _SEEN and max(told.gain(which) for which in causes) >= _LITTLE


def likeliest(told: Shifts) -> list[int]:
    """The zero or the tilt that explains most."""
    return max(_causes(told), key=told.gain)


def _causes(told: Shifts) -> list[list[int]]:
    """The zero that explains most, and a tilt, as far as the recording shows them."""
    drives = _shown(told)
    one = [max(drives, key=lambda i: told.gain([i]))] if drives else []
    return [which for which in (one, told.tilt) if which]


def _shown(told: Shifts) -> list[int]:
    """Drives whose zeros the recording shows."""
    return [i for i in told.homing if _sensible(told, i) and _sure(told, [i]) > 0]


def _sensible(told: Shifts, i: int) -> bool:
    """Whether a zero's error is small enough for slopes to tell it, and told to a part of it.

    What hardly shows, as a telescope's drive does, would take any error to explain the rest.
    """
    value, covariance = told.told([i])
    return bool(abs(value[0]) < _FARTHEST and covariance[0, 0] < _VAGUE**2)


def _rival(told: Shifts, one: int, other: int) -> bool:
    """Whether the zero of another drive explains as much as that of the first."""
    return told.gain([other]) > _RIVAL * told.gain([one]) and _sure(told, [one], [other]) < _NEEDED


def _better_explained(told: Shifts, one: int, loose: list[int]) -> bool:
    """Whether gains or offsets of the torques leave nothing to zeros and gravity.

    Those of all drives must do what these cannot; that of one drive is as simple as they are, but
    for a loose one's, which stand for whatever its prior lacks.
    """
    both = [which for which in ([one], told.tilt) if which]
    most = max(told.gain(which) for which in both)
    for others in (told.offsets, told.gains[1:]):
        if others and all(
            _sure(told, which, others) < _NEEDED <= _sure(told, others, which) for which in both
        ):
            return True
    chance = _CHANCE / told.rows
    for columns in (told.offsets, told.gains):
        tied = [k for i, k in enumerate(columns) if i not in loose]
        if any(told.gain([k]) > _MORE * most + chance for k in tied):
            return True
    return False


def _sure(told: Shifts, which: list[int], beside: list[int] | None = None) -> float:
    """Standard deviations from zero; 0 where the recording does not show these at all."""
    if not all(told.H[i, i] > 0 for i in which):
        return 0.0
    return told.certainty(which, beside)


def _zero(
    evidence: Evidence, motion: Motion, best: Candidate, told: Shifts, one: int
) -> tuple[float, float]:
    """The zero's error of one drive and half its interval, by Gauss–Newton steps."""
    map = best.map
    for _ in range(_STEPS):
        step, covariance = told.told([one])
        shift = list(map.shift)
        shift[one] += float(np.clip(step[0], -0.2, 0.2))
        trial = replace(map, shift=tuple(shift))
        found = residual(evidence.dynamics, motion, trial)
        if found is None or found.poses.share < best.residual.poses.share:
            break
        map = trial
        told = shifts(evidence.dynamics, motion, assigned(found, best.order))
        if abs(step[0]) < np.sqrt(covariance[0, 0]):
            break
    _, covariance = told.told([one])
    return map.shift[one], 2 * float(np.sqrt(covariance[0, 0]))


def _verdict(
    evidence: Evidence,
    told: Shifts,
    entries: Entries,
    rivals: list[int],
    way: tuple[float, float],
    *,
    grade: Grade,
    zero: bool,
    either: bool,
) -> Verdict:
    one, *rest = rivals
    name, *others = (evidence.robot.drives[i] for i in (one, *rest))
    linear = evidence.robot.is_linear(name)
    unit = "mm" if linear else "mrad"
    number = 1e3 * way[0]
    of_zero = f"a zero of {name} that is {abs(number):.3g} ± {1e3 * way[1]:.1g} {unit} off"
    if others:
        of_zero += f" (or one of {listed(others)}: the motion does not tell these apart)"
    angle, by = _tilt(told)
    of_tilt = f"a base out of level by {1e3 * angle:.3g} ± {1e3 * by:.1g} mrad"
    share = told.gain([one]) if zero else told.gain(told.tilt)
    shifted = entries.proposal({"position": {one: entries.shifted(one, way[0])}})
    turned = _gravity(evidence, told) if told.tilt else ()
    words = f"torques repeat with the pose what {of_zero if zero else of_tilt} would do"
    words += f", which explains {100 * share:.0f} % of what is left of them"
    if either:
        first, second = (of_zero, of_tilt) if zero else (of_tilt, of_zero)
        cause = f"one of both, the motion does not tell which: {first}, or {second}"
        cure = "home the drives anew and check the level of the base; then mend what was wrong"
        proposals = shifted if zero else turned
    elif zero:
        cause = f"homing: {of_zero}"
        cure, proposals = "home the drive anew, or declare its zero", shifted
    else:
        cause = f"a tilted base: {of_tilt}"
        cure, proposals = "level the base, or describe gravity as it is", turned
    return Verdict(
        "homing-or-tilt",
        grade,
        words,
        ", ".join([name, *others]) if zero else "",
        cause,
        cure,
        proposals,
        number=number if zero else 1e3 * angle,
        unit=unit if zero else "mrad",
    )


def _tilt(told: Shifts) -> tuple[float, float]:
    """Angle between gravity and its direction as described, and half its interval [rad]."""
    if not told.tilt:
        return 0.0, 0.0
    value, covariance = told.told(told.tilt)
    angle = float(np.linalg.norm(value))
    direction = value / max(angle, 1e-12)
    return angle, 2 * float(np.sqrt(direction @ covariance @ direction))


def _gravity(evidence: Evidence, told: Shifts) -> tuple[Proposal, ...]:
    g = np.array(evidence.robot.gravity)
    value, _ = told.told(told.tilt)
    axes = across(g)[[i - told.drives for i in told.tilt]]
    turned = g + sum(v * np.cross(a, g) for v, a in zip(value, axes, strict=True))
    turned *= np.linalg.norm(g) / np.linalg.norm(turned)
    return (Proposal("robot", (("gravity", [float(f"{x:.5g}") for x in turned]),)),)


def _good(evidence: Evidence, told: Shifts) -> Verdict:
    angle, by = _tilt(told)
    seen = "zeros and gravity go with the torques"
    if not 0 < by < _FARTHEST:
        return Verdict("homing-or-tilt", Grade.GOOD, seen)
    seen += f": a tilt of {1e3 * angle:.2g} ± {1e3 * by:.1g} mrad"
    return Verdict("homing-or-tilt", Grade.GOOD, seen, number=1e3 * angle, unit="mrad")


def _open(best: Candidate) -> Verdict:
    share = best.residual.poses.share
    return Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        f"the loops close at {100 * share:.0f} % of the samples only, and no unit, gear, sign or "
        "order of the drives makes them close at all",
        cause="a zero far off, or lengths of the description that are not the robot's",
        cure="check the drives' zeros and the robot's lengths",
        number=share,
    )
