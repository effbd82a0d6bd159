"""Verdicts on zeros of drives and the direction of gravity.

They are compared with the least-squares residual of a recording. Before a fit, rows are as recorded
and friction as described: clipped torques, a lag or another friction law can mimic a wrong zero,
and a wrong zero mimics one-way friction or a torque constant, which a fit then finds. So after it
they are compared with the residual of masked torques, with the fit's corrections and without.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import Evidence
from deltaid.checks.wiring.candidate import WiringHypothesis
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.homing import Shifts, shifts
from deltaid.checks.wiring.motion import FilteredMotion
from deltaid.checks.wiring.residual import residual
from deltaid.dynamics.geometry import across
from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.additions import extended
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Span
from deltaid.identification.fit import FittedProblem
from deltaid.identification.geometric_rows import geometric_rows
from deltaid.model.verdict import Grade, Proposal, Verdict, listed
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

# Standard deviations from zero to be reported, and below which a cause is not needed.
_SEEN, _NEEDED = 4.2, 3.5
# Least share of the residual that they must explain.
_LITTLE = 0.005
# Share of what one drive's zero explains that another's has to.
_RIVAL = 0.7
# Difference of shares that noise makes, times the number of rows, and a factor between those of
# causes that are alike.
_CHANCE, _MORE = 6.0, 1.05
# Largest errors of zeros [rad or m] that slopes determine, and largest standard deviations.
_FARTHEST, _VAGUE = 0.5, 0.05
# Gauss–Newton steps for a zero, and the largest [rad or m].
_STEPS, _LARGEST = 3, 0.2
# Tolerances that columns are made with after a fit [rad or m; rad].
_SIZE = 1e-3
# A base is built more level than this [rad]: a larger tilt is a mounting that is described wrongly,
# or a force that pulls at the platform, and no line to be written unseen.
_LEVELLED = 0.05
# Zeros and tilts beyond this [rad or m] are no likelier than another law of friction; smaller ones
# are believed unless the law explains more than chance: twice a logarithm of likelihoods, which
# noise that is not white raises several times.
_FAR, _CERTAIN = 0.05, 25.0


def zero_verdicts(case: RemappedRecording) -> Iterator[Verdict]:
    """Homing, tilt, one of both, or neither."""
    best, motion = case.best, case.motion
    shift = shifts(case.evidence.dynamics, motion, best)
    drives = _shown(shift)
    doubted = bool(drives) and _seen(shift)
    if not doubted or _better_explained(shift, np.flatnonzero(best.loose).tolist()):
        if not best.closes:
            yield _open(best)
        elif drives and not doubted:
            yield _good(shift)
        return
    drive = max(drives, key=lambda i: shift.gain([i]))
    beside = shift.certainty([drive], shift.tilt)
    instead = shift.certainty(shift.tilt, [drive]) if shift.tilt else 0.0
    # Zeros of several drives mimic any tilt, so the simpler one is reported where both remain.
    either, zero = (instead < _NEEDED) == (beside < _NEEDED), beside >= _NEEDED
    if either and shift.tilt:
        zero = shift.gain([drive]) > shift.gain(shift.tilt)
    least = _RIVAL * shift.gain([drive])
    rivals = [i for i in drives if i != drive and shift.gain([i]) > least]
    rivals = [drive, *(i for i in rivals if shift.certainty([drive], [i]) < _NEEDED)]
    way = _zero(case.evidence, motion, best, shift, drive)
    grade = Grade.DOUBTFUL if best.closes else Grade.WRONG
    yield _verdict(case.evidence, shift, rivals, way, grade=grade, zero=zero, either=either)


def _seen(shift: Shifts) -> bool:
    """Whether the likeliest zero, or a tilt, is significant and explains enough."""
    causes = _causes(shift)
    certainty = max((shift.certainty(cause) for cause in causes), default=0.0)
    return certainty >= _SEEN and max(shift.gain(cause) for cause in causes) >= _LITTLE


def _causes(shift: Shifts) -> list[list[int]]:
    """The zero that explains most, and a tilt, as far as they are observable."""
    drives = sorted(_shown(shift), key=lambda i: -shift.gain([i]))[:1]
    return [cause for cause in (drives, shift.tilt) if cause]


def _shown(shift: Shifts) -> list[int]:
    """Drives whose zero error is small enough for slopes and well determined: a weak column, as of
    a telescope's drive, would take any value to explain the residual."""
    shown = list[int]()
    for drive in range(shift.drives):
        (value,), ((variance,),) = shift.estimate([drive])
        if abs(value) < _FARTHEST and variance < _VAGUE**2 and shift.certainty([drive]) > 0:
            shown.append(drive)
    return shown


def _better_explained(shift: Shifts, loose: list[int]) -> bool:
    """Whether torque gains or offsets explain the residual instead of zeros and gravity: those of
    all drives by explaining what these cannot, that of one drive, which is as simple, by explaining
    more. A loose drive's gain and offset absorb errors of its prior."""
    causes = _causes(shift)
    for instead in (shift.offsets, shift.gains[1:]):
        if instead and all(
            shift.certainty(cause, instead) < _NEEDED <= shift.certainty(instead, cause)
            for cause in causes
        ):
            return True
    needed = _MORE * max(shift.gain(cause) for cause in causes) + _CHANCE / shift.rows
    return any(
        shift.gain([column]) > needed
        for columns in (shift.offsets, shift.gains)
        for i, column in enumerate(columns)
        if i not in loose
    )


def _zero(
    evidence: Evidence, motion: FilteredMotion, best: WiringHypothesis, shift: Shifts, drive: int
) -> tuple[float, float]:
    """The zero's error of one drive and half its interval, by Gauss–Newton steps."""
    map, share = best.map, best.residual.share
    for _ in range(_STEPS):
        (step,), ((variance,),) = shift.estimate([drive])
        zeros = list(map.shift)
        zeros[drive] += float(np.clip(step, -_LARGEST, _LARGEST))
        moved = residual(evidence.dynamics, motion, replace(map, shift=tuple(zeros)))
        if moved is None or moved.share < share:
            break
        map = moved.map
        shift = shifts(evidence.dynamics, motion, replace(best, residual=moved))
        if abs(step) < np.sqrt(variance):
            break
    return map.shift[drive], 2 * float(np.sqrt(shift.estimate([drive])[1][0, 0]))


def _verdict(
    evidence: Evidence,
    shift: Shifts,
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
        of_zero += f" (or one of {listed(others)}: the motion does not separate these)"
    angle, by = _tilt(shift)
    of_tilt = f"a base out of level by {1e3 * angle:.3g} ± {1e3 * by:.1g} mrad"
    if zero:
        share, number, text, rival = shift.gain([rivals[0]]), way[0], of_zero, of_tilt
        cause, cure = f"homing: {of_zero}", "home the drive anew, or declare its zero"
        shifted = {rivals[0]: evidence.shifted(rivals[0], way[0])}
        proposals = evidence.proposal({"position": shifted})
    else:
        share, number, text, rival, unit = shift.gain(shift.tilt), angle, of_tilt, of_zero, "mrad"
        cause = f"a tilted base: {of_tilt}"
        cure = "level the base, or describe gravity as it is"
        if angle > _LEVELLED:
            cause += ", or a force that pulls at the platform, as of a hose or a spring"
            cure = (
                "look at the mounting and at what pulls at the platform; measure the base's angle "
                "with a level, and describe gravity by it"
            )
        proposals = _gravity(evidence, shift, is_written=angle <= _LEVELLED) if shift.tilt else ()
    if either:
        cause = f"one of both, the motion does not show which: {text}, or {rival}"
        cure = "home the drives anew and check the level of the base; then correct what was wrong"
    return Verdict(
        "homing-or-tilt",
        grade,
        f"torques repeat with the pose what {text} would do, which explains {100 * share:.0f} % of "
        "the residual",
        ", ".join([name, *others]) if zero else "",
        cause,
        cure,
        proposals,
        1e3 * number,
        unit,
    )


def _tilt(shift: Shifts) -> tuple[float, float]:
    """Angle between gravity and its direction as described, and half its interval [rad]."""
    if not shift.tilt:
        return 0.0, 0.0
    turn, covariance = shift.estimate(shift.tilt)
    angle = float(np.linalg.norm(turn))
    direction = turn / max(angle, 1e-12)
    return angle, 2 * float(np.sqrt(direction @ covariance @ direction))


def _gravity(evidence: Evidence, shift: Shifts, *, is_written: bool) -> tuple[Proposal, ...]:
    g = np.array(evidence.robot.gravity)
    turn, _ = shift.estimate(shift.tilt)
    gravity = g + np.cross(turn @ across(g)[[i - shift.drives for i in shift.tilt]], g)
    gravity *= np.linalg.norm(g) / np.linalg.norm(gravity)
    return (Proposal("robot", (("gravity", [float(f"{x:.5g}") for x in gravity]),), is_written),)


def _good(shift: Shifts) -> Verdict:
    angle, by = _tilt(shift)
    seen = "zeros and gravity go with the torques"
    if not 0 < by < _FARTHEST:
        return Verdict("homing-or-tilt", Grade.GOOD, seen)
    seen += f": a tilt of {1e3 * angle:.2g} ± {1e3 * by:.1g} mrad"
    return Verdict("homing-or-tilt", Grade.GOOD, seen, number=1e3 * angle, unit="mrad")


def _open(best: WiringHypothesis) -> Verdict:
    share = best.residual.share
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
def still_seen(
    problem: FittedProblem, recording: PreparedRecording, described: RobotDescription
) -> bool:
    """Whether a zero or a tilt explains the residual of a fit, or as much as its additions."""
    fitted = _after_fit(problem, recording, frozenset())
    if _seen(fitted):
        return True
    names = {entry.name for entry in parameter_layout(described).parameters}
    added = {entry.name for entry in problem.dynamics.layout.parameters} - names
    gains = {entry.name for entry in problem.layout.parameters if entry.kind == "gain"}
    repairs = replace(recording.repairs, gears=None, gain=())
    bare = _after_fit(problem, replace(recording, repairs=repairs), frozenset(added | gains))
    if not _seen(bare):
        return False
    likeliest = max(_causes(bare), key=bare.gain)
    value, _ = bare.estimate(likeliest)
    instead = bare.left * (1.0 - bare.gain(likeliest))
    chance = bare.rows * np.log(max(instead, 1e-300) / max(fitted.left, 1e-300))
    return bool(np.linalg.norm(value) < _FAR and chance < _CERTAIN)


def _after_fit(
    problem: FittedProblem, recording: PreparedRecording, without: frozenset[str]
) -> Shifts:
    """Errors of zeros and gravity with the columns of a fit, some of them excluded; unobservable
    zeros and tilts have columns of zeros."""
    regressor = extended(problem.dynamics, problem.additions)
    rows = next(
        geometric_rows(
            regressor,
            problem.dynamics,
            recording,
            problem.values,
            np.sqrt(problem.information.weights),
            Tolerances(lengths=0.0, homing=_SIZE, mounting=_SIZE),
        )
    )
    tilts = [name for name in rows.names if name.startswith("tilt")]
    zeros = [f"zero of {drive}" for drive in problem.dynamics.robot.drives]
    names = [problem.layout.parameters[k].name for k in active_columns(regressor)]
    Y = rows.Y[:, [name not in without for name in names]]
    D = rows.over((*zeros, *tilts)) / _SIZE
    return Shifts.from_rows(Span.of_columns(Y), D, rows.tau, len(zeros), len(tilts))
