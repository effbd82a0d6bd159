"""Units, gears, signs, order and zeros of columns: which of them explain a recording.

All hypotheses are tried on the same filtered stretch (`motion`): do the loops close, and how large
is the least-squares residual (`residual`, `search`)? The best one is the `case` of all verdicts
(`columns`); a scale common to all torques is judged by the prior.
Zeros and gravity are judged by their own columns (`homing`, `zeros`), velocities by the derivatives
of positions (`velocity`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence, forget
from deltaid.check.wiring.candidate import Candidate
from deltaid.check.wiring.case import Case, overall
from deltaid.check.wiring.columns import (
    order_verdicts,
    position_verdicts,
    sign_verdicts,
    torque_verdicts,
)
from deltaid.check.wiring.copies import refuse_copies
from deltaid.check.wiring.cures import Entries
from deltaid.check.wiring.motion import Motion, motion
from deltaid.check.wiring.search import explained, together
from deltaid.check.wiring.velocity import velocity_verdicts
from deltaid.check.wiring.zeros import zero_verdicts
from deltaid.model.verdict import Grade, Verdict, worst

# Largest residual share of the torques for correct columns.
_EXPLAINED = 0.5
# Correlation with the prior's torque below which the column is another signal.
_SENSELESS = 0.2
# Part of the stretch to search on, if it has so many samples.
_FEW, _FEWEST = 150, 40
_PART = {"longest": 6.0, "oversampled": 10.0}


@dataclass(frozen=True, eq=False)
class _Trial:
    """A recording, and the hypotheses that explain it by itself."""

    evidence: Evidence
    motion: Motion
    good: tuple[Candidate, ...]


def checked_wiring(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on the mapping of positions, velocities and torques.

    Empty where the recording is too short to be filtered.

    Raises:
        RecordingError: the torque of a drive is a copy of another's.
    """
    return checked_wirings([evidence])[1][0]


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_wirings(
    records: Sequence[Evidence],
) -> tuple[tuple[Verdict, ...], list[tuple[Verdict, ...]]]:
    """Verdicts on columns that several recordings share, and those on each recording.

    Recordings whose columns have one mapping are judged together: one verdict for all of them.
    Errors as of `checked_wiring`.
    """
    trials = list[_Trial | None]()
    for record in records:
        trials.append(_trial(record))
        if len(records) > 1:
            forget(record)
    explained_ones = [trial for trial in trials if trial is not None and trial.good]
    shared = len(explained_ones) > 1 and all(
        trial.evidence.columns.drives == explained_ones[0].evidence.columns.drives
        for trial in explained_ones
    )
    common: tuple[Verdict, ...] = ()
    if shared:
        dynamics, motions = records[0].dynamics, [trial.motion for trial in explained_ones]
        goods = together(dynamics, motions, [trial.good for trial in explained_ones])
        explained_ones = [
            replace(t, good=good) for t, good in zip(explained_ones, goods, strict=True)
        ]
        clearest = min((t for t in explained_ones if t.good), key=lambda t: t.good[0].left)
        common = _of_columns(_case(clearest))
    own = {id(trial.evidence): trial for trial in explained_ones}
    each = list[tuple[Verdict, ...]]()
    for record, trial in zip(records, trials, strict=True):
        if trial is None:
            each.append(())
        elif not trial.good or not own[id(record)].good:
            each.append((_out_of_reach(record),))
        else:
            case = _case(own[id(record)])
            each.append(_of_recording(case, common if shared else _of_columns(case), shared=shared))
    return common, each


def _trial(evidence: Evidence) -> _Trial | None:
    """None where the recording is too short to be filtered."""
    refuse_copies(evidence)
    fine = motion(evidence.rows)
    if fine is None or len(fine.tau) < _FEWEST:
        return None
    coarse = motion(evidence.rows, **_PART)
    if coarse is None or len(coarse.tau) < _FEW:
        coarse = fine
    return _Trial(evidence, fine, explained(evidence.dynamics, fine, coarse))


def _case(trial: _Trial) -> Case:
    return Case(trial.evidence, trial.motion, trial.good, Entries(trial.evidence))


def _of_columns(case: Case) -> tuple[Verdict, ...]:
    families = position_verdicts, sign_verdicts, order_verdicts, torque_verdicts
    return tuple(verdict for family in families for verdict in family(case))


def _of_recording(case: Case, columns: tuple[Verdict, ...], *, shared: bool) -> tuple[Verdict, ...]:
    """Those on its columns, unless they are shared, on zeros and on velocities."""
    verdicts, evidence = list(columns), case.evidence
    senseless = case.best.left > _EXPLAINED or case.along < _SENSELESS
    if case.best.closes and not verdicts and senseless:
        verdicts.append(_senseless(case))
    if worst(verdicts) is not Grade.WRONG:
        verdicts += zero_verdicts(evidence, case.motion, case.best, case.entries)
    verdicts += velocity_verdicts(case)
    if worst(verdicts) in (Grade.GOOD, Grade.CANNOT_TELL) and not senseless:
        seen = (
            f"the loops close, torques go with the motion of their drives ({case.along:.2g} is the "
            f"least correlation with those of the prior) and are {overall(case.ratios):.2g} times "
            "those"
        )
        verdicts.insert(0, Verdict("drive-order", Grade.GOOD, seen, number=case.along))
    return tuple(verdicts[len(columns) :] if shared else verdicts)


def _senseless(case: Case) -> Verdict:
    i = int(np.argmin(np.where(case.best.residual.still, 1.0, case.best.along)))
    return Verdict(
        "drive-order",
        Grade.CANNOT_TELL,
        f"the torque of {case.names[i]} hardly goes with its motion: its correlation with the "
        f"prior's is {case.best.along[i]:.2g}, and no unit, sign or order explains the torques",
        subject=case.names[i],
        cause="the columns are of other signals, the drive hardly moves, or the prior is far off",
        cure="check by name which signals the torque columns hold",
        number=float(case.best.along[i]),
    )


def _out_of_reach(evidence: Evidence) -> Verdict:
    linear = [evidence.robot.is_linear(drive) for drive in evidence.robot.drives]
    units = "millimetres" if all(linear) else "degrees" if not any(linear) else "degrees or mm"
    return Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        "the loops do not close along the recording, whatever is tried: neither numbers in "
        f"{units}, nor positions of the motor behind a gear, nor another sign of a drive, nor "
        "another order of the drives makes them close",
        cause="lengths of the description that are not the robot's, or zeros of several drives",
        cure="check the lengths, and where the drives have their zero (rotary: arm horizontal and "
        "outwards, positive = down)",
    )
