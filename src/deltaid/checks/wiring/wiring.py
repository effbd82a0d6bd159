"""Checks of wiring: units, gears, signs, order and zeros of columns.

All hypotheses are tried on the same filtered stretch (`motion`) by two criteria: loops close, and
the least-squares residual is small (`residual`, `search`). All verdicts refer to the best one
(`columns`); a scale common to all torques follows from the prior. Zeros and gravity have columns of
their own (`zeros`), velocities are compared with derivatives of positions (`velocity`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import UNRELATED, Evidence, forget
from deltaid.checks.wiring.candidate import SENSIBLE
from deltaid.checks.wiring.columns import COUNTS, column_verdicts
from deltaid.checks.wiring.course import TorqueCourse
from deltaid.checks.wiring.explained import RemappedRecording, overall
from deltaid.checks.wiring.joined import lag_of_all
from deltaid.checks.wiring.over_time import over_time_verdicts
from deltaid.checks.wiring.residual import FEWEST, FilteredMotion, motion, residual
from deltaid.checks.wiring.search import SAMPLES, explained, together
from deltaid.checks.wiring.time_unit import time_unit_verdicts, too_fast_verdicts
from deltaid.checks.wiring.velocity import velocity_verdicts
from deltaid.checks.wiring.zeros import zero_verdicts
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.estimation.problem import lengths
from deltaid.model.verdict import Grade, Proposal, Verdict, worst
from deltaid.recording.opening import ITS_ROBOT, OTHER_ROBOT
from deltaid.recording.resolution import extra_drives

# Part of the stretch to search on, if it has enough samples.
_PART = {"longest": 6.0, "oversampled": 10.0}
# 1 − ρ² below which two columns are one signal; 1 − ρ² of positions above which drives move
# differently and must have different torques; least ρ² of torques of drives that move alike, up and
# down.
_COPIED, _UNLIKE, _APART = np.finfo(float).eps ** 0.5, 1e-5, 0.75


def checked_wiring(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on the mapping of positions, velocities and torques.

    Of a recording that is too short to be filtered, only its speed is judged.

    Raises:
        RecordingError: the torque of a drive is a copy of another's, times a factor, though the two
            drives move in different ways; or its position, though their torques differ. Or the
            robot stands still.
    """
    return checked_wirings([evidence])[1][0]


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_wirings(
    records: Sequence[Evidence],
) -> tuple[tuple[Verdict, ...], list[tuple[Verdict, ...]]]:
    """Verdicts on columns that several recordings share, and those on each recording.

    Recordings with one mapping are judged together, with one verdict for all of them. Raises what
    `checked_wiring` raises.
    """
    _refuse_rest(records)
    judged, over_time = dict[int, RemappedRecording](), dict[int, tuple[Verdict, ...]]()
    for k, record in enumerate(records):
        _refuse_copies(record)
        if (fine := _long_motion(record)) is not None:
            log = _explained(record, fine)
            course = TorqueCourse.from_recording(log) if log.good else None
            over_time[k] = tuple(over_time_verdicts(log, course)) if course is not None else ()
            over_time[k] = over_time[k] or tuple(time_unit_verdicts(log))
            judged[k] = log if course is None or over_time[k] else _on_time(log, course)
        if len(records) > 1:
            forget(record)
    shown = {k: log for k, log in judged.items() if log.good and not over_time[k]}
    drives = [log.evidence.columns.drives for log in shown.values()]
    common = None
    if len(drives) > 1 and all(columns == drives[0] for columns in drives):
        motions, goods = zip(*((log.motion, log.good) for log in shown.values()), strict=True)
        goods = together(records[0].dynamics, motions, goods)
        joint = {k: replace(judged[k], good=good) for k, good in zip(shown, goods, strict=True)}
        if all(_goes_with_others(joint[k], judged[k]) for k in shown):
            judged |= joint
            sensible = [log for log in joint.values() if log.good]
            clearest = min(sensible, key=lambda log: log.best.unexplained)
            common = column_verdicts(clearest)
    each = [
        (*_other_drives(record), *verdicts)
        for k, record in enumerate(records)
        for verdicts in [
            over_time[k] or _of_recording(judged[k], common)
            if k in judged
            else tuple(too_fast_verdicts(record))
        ]
    ]
    return common or (), each


def too_short_verdicts(record: Evidence, wiring: Sequence[Verdict]) -> Iterator[Verdict]:
    """A verdict on a usable recording whose columns `wiring` could not judge: of a description or
    wiring that was not checked nothing is known."""
    if {verdict.key for verdict in wiring} <= {"drive-count"} and _long_motion(record) is None:
        seconds = float(np.ptp(record.rows.time))
        yield Verdict(
            "drive-order",
            Grade.CANNOT_TELL,
            f"the motion in these {seconds:.3g} s is too short to check units, signs and order of "
            "the columns, and the direction of gravity",
            cure="record longer: at least 10 s of motion without a gap",
            number=seconds,
            unit="s",
        )


def _explained(record: Evidence, fine: FilteredMotion) -> RemappedRecording:
    part = motion(record.on_time, **_PART)
    coarse = fine if part is None or len(part.tau) < SAMPLES else part
    return RemappedRecording(record, fine, explained(record.dynamics, fine, coarse))


def _on_time(log: RemappedRecording, course: TorqueCourse) -> RemappedRecording:
    """With a lag of all torques corrected if anything seems wrong: lags spoil inertia, which
    decides units that no loop does, and gravity."""
    record = log.evidence
    if record.settings.lag != "estimate" or worst(_of_recording(log, None)) is Grade.GOOD:
        return log
    if (late := lag_of_all(course)) is None:
        return log
    record = replace(record, settings=record.settings.model_copy(update={"lag": (late,)}))
    fine = _long_motion(record)
    return log if fine is None else _explained(record, fine)


def _long_motion(record: Evidence) -> FilteredMotion | None:
    """The liveliest stretch; None where it is too short to decide between hypotheses."""
    fine = None if record.stands else motion(record.on_time)
    return fine if fine is not None and len(fine.tau) >= FEWEST else None


def _goes_with_others(joint: RemappedRecording, alone: RemappedRecording) -> bool:
    """Whether columns as all recordings share them best make sense in one that does so alone, and
    its own best ones do not rule them out."""
    if not joint.good or (alone.best.key != joint.best.key and alone.best.beats(joint.best)):
        return False
    sensible = joint.least_correlation >= SENSIBLE[0]
    return sensible or alone.least_correlation < SENSIBLE[0]


def _refuse_rest(records: Sequence[Evidence]) -> None:
    """Refuse recordings that all are of a robot at rest: noise is no motion to judge columns by."""
    if records and all(record.stands for record in records):
        moved = max(float(record.moved.max()) for record in records)
        raise RecordingError(
            f"the robot stands still: no position changes by more than {moved:.2g} rad or m",
            where=str(records[0].table.path),
            cure="record a motion of all drives, such as `deltaid excite` plans; if it did move, "
            "map the columns that hold its positions, with their unit",
        )


def _refuse_copies(evidence: Evidence) -> None:
    rows, names, columns = evidence.rows, evidence.robot.drives, evidence.columns
    if rows.tau.shape[1] != len(names) or rows.q.shape[1] != len(names):
        return
    finite = np.isfinite(np.hstack([rows.q, rows.tau])).all(axis=1)
    moves, pulls = (_correlations(numbers[finite]) ** 2 for numbers in (rows.q, rows.tau))
    copies = (
        ("torque", columns.torque, pulls, moves < 1 - _UNLIKE, "the drives move unlike each other"),
        ("position", columns.position, moves, pulls < _APART, "their torques differ"),
    )
    for (quantity, channels, alike, differ, why), (i, j) in product(
        copies, combinations(range(len(names)), 2)
    ):
        if alike[i, j] > 1 - _COPIED and differ[i, j]:
            raise RecordingError(
                f"the {quantity}s of {names[i]} and {names[j]} are one signal: column "
                f"'{channels[i].column}' and column '{channels[j].column}' repeat each other in "
                f"every row, and {why}",
                where=str(evidence.table.path),
                cure=f"map each drive's own {quantity}; if only one of them was recorded, record "
                "again",
            )


def _other_drives(evidence: Evidence) -> Iterator[Verdict]:
    extra = extra_drives(evidence.table, evidence.columns, evidence.mapping, evidence.dynamics.dof)
    if extra:
        seen = f"the log {extra}"
        yield Verdict("drive-count", Grade.DOUBTFUL, seen, "", OTHER_ROBOT, ITS_ROBOT)


def _correlations(numbers: np.ndarray) -> np.ndarray:
    """Correlations of columns; 0 for constant ones."""
    if len(numbers):  # rounding of the mean leaves something of constant columns
        numbers = (numbers - numbers.mean(axis=0)) * (np.ptp(numbers, axis=0) > 0)
    unit = numbers / lengths(numbers)
    return unit.T @ unit


def _of_recording(
    log: RemappedRecording, common: tuple[Verdict, ...] | None
) -> tuple[Verdict, ...]:
    if not log.good:
        return (_out_of_reach(log.evidence),)
    verdicts = list(column_verdicts(log) if common is None else common)
    senseless = (
        log.unrelated or log.best.unexplained > SENSIBLE[1] or log.least_correlation < UNRELATED
    )
    if log.best.closes and not verdicts:
        verdicts += [*_upside_down(log)] or ([_senseless(log)] if senseless else [])
    verdicts += zero_verdicts(log) if worst(verdicts) is not Grade.WRONG else ()
    verdicts += velocity_verdicts(log)
    if worst(verdicts) in (Grade.GOOD, Grade.CANNOT_TELL) and not senseless:
        seen = (
            "the loops close, and torques correlate with those of the prior by at least "
            f"{log.least_correlation:.2g}; they are {overall(log.ratios):.2g} times those"
        )
        verdicts.insert(0, Verdict("drive-order", Grade.GOOD, seen, number=log.least_correlation))
    return tuple(verdicts[len(common or ()) :])


def _upside_down(log: RemappedRecording) -> Iterator[Verdict]:
    """A verdict where torques go with gravity that is opposite to the described one."""
    robot, gravity = log.evidence.robot, [0.0 - g for g in log.evidence.robot.gravity]
    if log.least_correlation >= SENSIBLE[0]:
        return
    turned = compiled(robot.changed(gravity=tuple(gravity)))
    again = residual(turned, log.motion, log.best.map)
    along = (
        replace(log, good=(replace(log.best, residual=again),)).least_correlation if again else -1.0
    )
    if along < SENSIBLE[0]:
        return
    yield Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        f"torques go with gravity in the opposite direction: {along:.2g} is then their least "
        f"correlation with the prior's, and {log.least_correlation:.2g} as described",
        cause="gravity in the description has the wrong sign, or the robot is mounted the other "
        "way up",
        cure="describe gravity as it acts in the robot's frame",
        proposals=(Proposal("robot", (("gravity", gravity),)),),
        number=along,
    )


def _senseless(log: RemappedRecording) -> Verdict:
    if log.unrelated:
        return Verdict(
            "drive-order",
            Grade.WRONG,
            f"the torques have nothing to do with the motion: the best robot {log.fits}, and no "
            "unit, sign or order helps",
            cause="they are of another recording, at other rows than the positions, or no torques",
            cure="check by name which signals the torque columns hold, and that positions and "
            "torques are of one run",
            number=log.least_correlation,
        )
    i = int(np.argmin(np.where(log.best.residual.still, 1.0, log.best.correlations)))
    return Verdict(
        "drive-order",
        Grade.CANNOT_TELL,
        f"the torque of {log.names[i]} hardly goes with its motion: its correlation with the "
        f"prior's is {log.best.correlations[i]:.2g}, and no unit, sign or order explains the "
        "torques",
        subject=log.names[i],
        cause="the columns are of other signals, the drive hardly moves, or the prior is far off",
        cure="check by name which signals the torque columns hold",
        number=float(log.best.correlations[i]),
    )


def _out_of_reach(evidence: Evidence) -> Verdict:
    linear = evidence.robot.linear_drives
    units = "millimetres" if all(linear) else "degrees" if not any(linear) else "degrees or mm"
    cause = "lengths of the description that are not the robot's, or zeros of several drives"
    cure = (
        "check the lengths, and where the drives have their zero (rotary: arm horizontal and "
        "outwards, positive = down)"
    )
    if evidence.are_counts:
        cause, cure = f"positions are {COUNTS[0]}", COUNTS[1]
    return Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        "the loops do not close along the recording, whatever is tried: neither numbers in "
        f"{units}, nor positions of the motor behind a gear, nor another sign of a drive, nor "
        "another order of the drives makes them close",
        cause=cause,
        cure=cure,
    )
