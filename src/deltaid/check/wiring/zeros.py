"""Verdicts on zeros of drives and the direction of gravity.

They are compared with what least squares leave of a recording. Before a fit, rows are as recorded
and friction as described: clipped torques, a lag or another law of friction may look like a zero
that is off; and a zero that is off looks like friction that differs by direction or like a torque
constant, which a fit then finds. So after it, they are compared with what is left of masked
torques, beside all that the fit has put right and beside the description alone.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.wiring.candidate import CLOSED, Candidate, assigned
from deltaid.check.wiring.cures import Entries
from deltaid.check.wiring.homing import Shifts, shifts
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import residual
from deltaid.dynamics.geometry import across
from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.additions import extended
from deltaid.estimation.information import active_columns
from deltaid.estimation.span import Span
from deltaid.identification.fit import FittedProblem
from deltaid.identification.geometry import geometric_rows
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

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
# Gauss–Newton steps for a zero, and the largest [rad or m].
_STEPS, _LARGEST = 3, 0.2
# What columns are made of after a fit [rad or m; rad].
_SIZE = 1e-3
# Zeros and tilts beyond this [rad or m] are no likelier than another law of friction; smaller ones
# are believed unless the law explains more than chance: twice a logarithm of likelihoods, which
# noise that is not white raises several times.
_FAR, _CERTAIN = 0.05, 25.0


def zero_verdicts(
    evidence: Evidence, motion: Motion, best: Candidate, entries: Entries
) -> Iterator[Verdict]:
    """Homing, tilt, one of both, or neither."""
    told = shifts(evidence.dynamics, motion, best)
    drives, closes = _shown(told), best.residual.poses.share >= CLOSED
    doubted = bool(drives) and _seen(told)
    if not doubted or _better_explained(told, np.flatnonzero(best.loose).tolist()):
        if not closes:
            yield _open(best)
        elif drives and not doubted:
            yield _good(told)
        return
    one = max(drives, key=lambda i: told.gain([i]))
    beside = told.certainty([one], told.tilt)
    instead = told.certainty(told.tilt, [one]) if told.tilt else 0.0
    # Zeros of several drives mimic any tilt, so the simpler of both is said where both are left.
    either = (instead < _NEEDED) == (beside < _NEEDED)
    zero = told.gain([one]) > told.gain(told.tilt) if either and told.tilt else beside >= _NEEDED
    rivals = [
        i
        for i in drives
        if told.gain([i]) > _RIVAL * told.gain([one])
        and (i == one or told.certainty([one], [i]) < _NEEDED)
    ]
    rivals.sort(key=lambda i: i != one)
    way = _zero(evidence, motion, best, told, one)
    grade = Grade.DOUBTFUL if closes else Grade.WRONG
    yield _verdict(evidence, told, entries, rivals, way, grade=grade, zero=zero, either=either)


def _seen(told: Shifts) -> bool:
    """Whether the zero that explains most, or a tilt, is there beyond doubt and explains enough."""
    causes = _causes(told)
    sure = max((told.certainty(which) for which in causes), default=0.0)
    return sure >= _SEEN and max(told.gain(which) for which in causes) >= _LITTLE


def _causes(told: Shifts) -> list[list[int]]:
    """The zero that explains most, and a tilt, as far as the recording shows them."""
    one = max(_shown(told), key=lambda i: told.gain([i]), default=None)
    return [which for which in ([] if one is None else [one], told.tilt) if which]


def _shown(told: Shifts) -> list[int]:
    """Drives whose zeros are off by little enough for slopes to tell it, and told to a part of it:
    what hardly shows, as a telescope's drive does, would take any error to explain the rest."""
    found = []
    for i in range(told.drives):
        (value,), ((variance,),) = told.told([i])
        if abs(value) < _FARTHEST and variance < _VAGUE**2 and told.certainty([i]) > 0:
            found.append(i)
    return found


def _better_explained(told: Shifts, loose: list[int]) -> bool:
    """Whether gains or offsets of the torques leave nothing to zeros and gravity: those of all
    drives by doing what these cannot, that of one drive, which is as simple as they are, by doing
    more. A loose drive's stand for whatever its prior lacks."""
    causes = _causes(told)
    for others in (told.offsets, told.gains[1:]):
        if others and all(
            told.certainty(which, others) < _NEEDED <= told.certainty(others, which)
            for which in causes
        ):
            return True
    least = _MORE * max(told.gain(which) for which in causes) + _CHANCE / told.rows
    return any(
        told.gain([column]) > least
        for columns in (told.offsets, told.gains)
        for i, column in enumerate(columns)
        if i not in loose
    )


def _zero(
    evidence: Evidence, motion: Motion, best: Candidate, told: Shifts, one: int
) -> tuple[float, float]:
    """The zero's error of one drive and half its interval, by Gauss–Newton steps."""
    map = best.map
    for _ in range(_STEPS):
        (step,), ((variance,),) = told.told([one])
        shift = list(map.shift)
        shift[one] += float(np.clip(step, -_LARGEST, _LARGEST))
        trial = replace(map, shift=tuple(shift))
        found = residual(evidence.dynamics, motion, trial)
        if found is None or found.poses.share < best.residual.poses.share:
            break
        map = trial
        told = shifts(evidence.dynamics, motion, assigned(found, best.order))
        if abs(step) < np.sqrt(variance):
            break
    return map.shift[one], 2 * float(np.sqrt(told.told([one])[1][0, 0]))


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
    """Of a zero or else a tilt, or of either."""
    name, *others = (evidence.robot.drives[i] for i in rivals)
    unit = "mm" if evidence.robot.is_linear(name) else "mrad"
    of_zero = f"a zero of {name} that is {abs(1e3 * way[0]):.3g} ± {1e3 * way[1]:.1g} {unit} off"
    if others:
        of_zero += f" (or one of {listed(others)}: the motion does not tell these apart)"
    angle, by = _tilt(told)
    of_tilt = f"a base out of level by {1e3 * angle:.3g} ± {1e3 * by:.1g} mrad"
    if zero:
        share, number, said, other = told.gain([rivals[0]]), way[0], of_zero, of_tilt
        cause, cure = f"homing: {of_zero}", "home the drive anew, or declare its zero"
        shifted = {rivals[0]: entries.shifted(rivals[0], way[0])}
        proposals = entries.proposal({"position": shifted})
    else:
        share, number, said, other, unit = told.gain(told.tilt), angle, of_tilt, of_zero, "mrad"
        cause = f"a tilted base: {of_tilt}"
        cure = "level the base, or describe gravity as it is"
        proposals = _gravity(evidence, told) if told.tilt else ()
    if either:
        cause = f"one of both, the motion does not tell which: {said}, or {other}"
        cure = "home the drives anew and check the level of the base; then mend what was wrong"
    return Verdict(
        "homing-or-tilt",
        grade,
        f"torques repeat with the pose what {said} would do, which explains {100 * share:.0f} % of "
        "what is left of them",
        ", ".join([name, *others]) if zero else "",
        cause,
        cure,
        proposals,
        number=1e3 * number,
        unit=unit,
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
    turned = g + np.cross(value @ across(g)[[i - told.drives for i in told.tilt]], g)
    turned *= np.linalg.norm(g) / np.linalg.norm(turned)
    return (Proposal("robot", (("gravity", [float(f"{x:.5g}") for x in turned]),)),)


def _good(told: Shifts) -> Verdict:
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


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def still_seen(problem: FittedProblem, recording: Recording, described: RobotDescription) -> bool:
    """Whether a zero or a tilt still explains what a fit leaves of a recording, or explains as
    much as what the fit has added to the description."""
    fitted = _after_fit(problem, recording, frozenset())
    if _seen(fitted):
        return True
    known = {one.name for one in parameter_layout(described).parameters}
    added = {one.name for one in problem.dynamics.layout.parameters} - known
    gains = {one.name for one in problem.layout.parameters if one.kind == "gain"}
    repairs = replace(recording.repairs, gears=None, gain=())
    plain = _after_fit(problem, replace(recording, repairs=repairs), frozenset(added | gains))
    if not _seen(plain):
        return False
    likeliest = max(_causes(plain), key=plain.gain)
    value, _ = plain.told(likeliest)
    instead = plain.left * (1.0 - plain.gain(likeliest))
    chance = plain.rows * np.log(max(instead, 1e-300) / max(fitted.left, 1e-300))
    return bool(np.linalg.norm(value) < _FAR and chance < _CERTAIN)


def _after_fit(problem: FittedProblem, recording: Recording, without: frozenset[str]) -> Shifts:
    """What a recording says of zeros and gravity beside the columns of a fit, some of them left
    out; zeros and tilts that torques do not show have columns of zeros."""
    regressor = extended(problem.dynamics, problem.additions)
    rows = geometric_rows(
        regressor,
        problem.dynamics,
        recording,
        problem.p,
        np.sqrt(problem.information.drive_weights),
        Tolerances(lengths=0.0, homing=_SIZE, mounting=_SIZE),
    )
    tilts = [name for name in rows.names if name.startswith("tilt")]
    zeros = [f"zero of {drive}" for drive in problem.dynamics.robot.drives]
    names = [problem.layout.parameters[k].name for k in active_columns(regressor)]
    Y = rows.Y[:, [name not in without for name in names]]
    D = rows.over((*zeros, *tilts)) / _SIZE
    return Shifts.of(Span.of(Y), D, rows.tau, len(zeros), len(tilts))
