"""Which friction law each joint needs, decided by what the described one leaves of the torques.

1. Rows of the recordings in memory, without what the robot's parameters and a lag of each drive
   explain (`friction_rows`). If no further term of any joint explains more of them than chance,
   everything stays as described.
2. The term that is least likely by chance is added, and again to what it leaves. Terms of the
   description stay: they are part of what the rows are without.
3. The constants of the terms that were added are refined together with all coefficients, positive
   as they must be, by Gauss–Newton (`friction_constants`).
4. What the refined laws can do without is dropped again. There is no second round: it would only
   fit the noise.

Chance is measured by the scatter of the rows between stretches of time, or by white noise where
that is larger.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.effects.contest import surprise
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.span import Rows, independent
from deltaid.identification.friction_constants import Refined, refined
from deltaid.identification.friction_curves import LawConstants
from deltaid.identification.friction_options import (
    Option,
    Options,
    Variant,
    columns_of,
    remaining,
)
from deltaid.identification.friction_rows import FrictionRows, friction_rows
from deltaid.identification.gains import shown_by_torques
from deltaid.identification.lag_stage import without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.model.friction_record import FrictionChoice, FrictionTrial
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_text import written

# A term is added where chance explains as much to one of all that were tried once in so many
# decades of recordings; and where it makes this share of a drive's largest torque, less than which
# is the error of differentiated positions.
_SEEN, _LEAST = 3.5, 3e-4
# Decades that the number of joints and kinds of terms takes.
_TRIALS = 1.3
# Terms that are added at most.
_MOST = 25

Columns = Float[np.ndarray, "rows _"]


@dataclass(frozen=True, eq=False)
class _Tried:
    """An addition to a joint's law.

    Attributes:
        option, variant: which.
        gain: by what share the squared error falls.
        left: share of the largest torque that is left.
        times: what it explains, as a multiple of what chance makes of that, as a root.
        surprise: how unlikely that is by chance, in decades, the number of trials counted.
        directions: orthonormal columns that it adds.
        useful: whether it is beyond chance, and large enough to matter.
    """

    option: Option
    variant: Variant
    gain: float
    left: float
    times: float
    surprise: float
    directions: Columns
    useful: bool


def chosen_friction(setup: Setup, progress: Progress) -> Setup:
    """The friction laws that recordings ask for, unless those of the description are wanted."""
    if setup.settings.friction != "choose" or not setup.robot.friction:
        return setup
    if any(setup.is_disturbed(k) for k in range(len(setup.recordings))):
        return setup
    progress("looking for friction that the description lacks")
    beside = shown_by_torques(without_lags(setup.additions))
    try:
        rows = friction_rows(setup.dynamics, setup.recordings, beside)
    except RecordingError:
        return setup  # too short to look at; the fit says so where it matters
    robot, choice = choose_friction(rows, progress)
    told = _corrections(setup.robot, robot, choice)
    setup = setup.with_robot(robot).changed(friction_choice=choice).told(told, "friction")
    constants = LawConstants(setup.dynamics)
    return setup.changed(
        additions=(*setup.additions, *([constants] if constants.parameters else []))
    )


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def choose_friction(
    rows: FrictionRows, progress: Progress = lambda _: None
) -> tuple[RobotDescription, FrictionChoice]:
    """The robot with the friction laws that its recordings ask for, and how they were chosen."""
    options, robot = Options(rows), rows.dynamics.robot
    steps, first = _extended(rows, options)
    rows = _carrying(rows, steps)
    kept, laws, left = _refined(rows, steps, progress)
    choice = FrictionChoice(
        folds=STRETCHES,
        plain_error=rows.share(rows.left),
        chosen_error=rows.share(left),
        steps=tuple(_record(one, useful=one in kept) for one in steps),
        trials=tuple(_record(one, useful=one.useful) for one in first),
    )
    return robot.changed(friction=dict(robot.friction) | laws), choice


def _corrections(
    before: RobotDescription, after: RobotDescription, choice: FrictionChoice
) -> list[Correction]:
    """One for each joint whose law was changed."""
    found = list[Correction]()
    for joint, law in after.friction.items():
        steps = [one for one in choice.steps if one.useful and one.joint == joint]
        if not steps:
            continue
        left = float(np.prod([1 - one.gain for one in steps]))
        sure = max(one.significance for one in steps)
        found.append(
            Correction(
                kind="friction",
                subject=joint,
                text=f"the law is now {written(law)}, no longer {written(before.friction[joint])}: "
                f"squared errors of the torques fall by {100 * (1 - left):.2g} %, {sure:.2g} times "
                "what chance would explain",
            )
        )
    return found


def _extended(rows: FrictionRows, options: Options) -> tuple[list[_Tried], tuple[_Tried, ...]]:
    """Add what chance explains least until nothing is left to say; and the first round's trials."""
    bare, left = rows.bare(options.columns), rows.left
    open_, steps, first = options.all, list[_Tried](), ()
    for _ in range(_MOST):
        trials = tuple(
            one for option in open_ if (one := _tried(rows, option, bare, left)) is not None
        )
        first = first or trials
        useful = [one for one in trials if one.useful]
        if not useful:
            break
        best = _simplest(max(useful, key=lambda one: one.surprise), useful, rows, bare, left)
        steps.append(best)
        open_ = remaining(open_, best.option)
        U = best.directions
        bare, left = bare - U @ (U.T @ bare), left - U @ (U.T @ left)
    return steps, first


def _carrying(rows: FrictionRows, steps: Sequence[_Tried]) -> FrictionRows:
    """Rows whose gears carry what losses by load were seen by."""
    moved = rows.moved.copy()
    for one in steps:
        if one.option.kind == "load":
            moved[rows.dynamics.robot.drives.index(one.option.joint)] = one.variant.moved
    return replace(rows, moved=moved)


def _simplest(
    best: _Tried, useful: Sequence[_Tried], rows: FrictionRows, bare: Columns, left: Rows
) -> _Tried:
    """An offset in place of a law for each direction, if what that has more is chance."""
    if best.option.kind != "both_ways":
        return best
    same = (one for one in useful if one.option.joint == best.option.joint)
    for one in (one for one in same if one.option.kind == "offset"):
        U = one.directions
        more = _tried(rows, best.option, bare - U @ (U.T @ bare), left - U @ (U.T @ left))
        if more is None or not more.useful:
            return one
    return best


def _refined(
    rows: FrictionRows, steps: Sequence[_Tried], progress: Progress
) -> tuple[list[_Tried], dict[str, Friction], Rows]:
    """What is kept of the steps, the laws that follow with refined constants, and what is left."""
    kept = list(steps)
    while kept:
        progress(f"refining friction laws of {len({one.option.joint for one in kept})} joints")
        found = refined(rows, _laws(rows, kept))
        spare = _imitated(rows, kept, found) or _spare(rows, kept, found)
        if spare is None:
            return kept, found.laws, found.left
        kept.remove(spare)
    return [], {}, rows.left


def _laws(rows: FrictionRows, steps: Sequence[_Tried]) -> dict[str, Friction]:
    """Laws after some steps."""
    laws = dict[str, Friction]()
    for one in sorted(steps, key=lambda one: one.option.kind != "offset"):
        joint = one.option.joint
        laws[joint] = laws.get(joint, rows.dynamics.robot.friction[joint]).changed(
            **one.variant.more
        )
    return laws


def _imitated(rows: FrictionRows, steps: Sequence[_Tried], found: Refined) -> _Tried | None:
    """One of two terms with constants that a joint got, where the other one alone can do as well
    with constants of its own; None if all are needed."""
    curved = [one for one in steps if one.option.constants]
    doubled = [one for one in curved if sum(x.option.joint == one.option.joint for x in curved) > 1]
    level = float(found.left @ found.left) / max(len(found.left) - rows.span.rank, 1)
    worst: tuple[float, _Tried] | None = None
    for one in doubled:
        without = refined(rows, _laws(rows, [x for x in steps if x is not one])).left
        more = float(without @ without) - float(found.left @ found.left)
        seen = surprise(max(more, 0.0) / level, 1 + one.option.constants) - _TRIALS
        if seen <= _SEEN and (worst is None or seen < worst[0]):
            worst = seen, one
    return worst[1] if worst else None


def _spare(rows: FrictionRows, steps: Sequence[_Tried], found: Refined) -> _Tried | None:
    """The step that refined laws can do without best; None if they need all.

    Each is judged beside all others, with the constants as they are now.
    """
    columns, places = np.zeros((len(rows.tau), 0)), list[range]()
    for one in steps:
        own = columns_of(rows, found.laws[one.option.joint], one.option)
        places.append(range(columns.shape[1], columns.shape[1] + own.shape[1]))
        columns = np.hstack([columns, own])
    bare, left = rows.bare(columns / np.linalg.norm(columns, axis=0)), rows.left
    worst: tuple[float, _Tried] | None = None
    for one, place in zip(steps, places, strict=True):
        others = [k for k in range(columns.shape[1]) if k not in place]
        U = bare[:, others] @ independent(bare[:, others])
        variant = replace(one.variant, columns=tuple(place))
        option = replace(one.option, variants=(variant,), positive=False)
        now = _tried(rows, option, bare - U @ (U.T @ bare), left - U @ (U.T @ left))
        size = now.surprise if now is not None else 0.0
        if (now is None or not now.useful) and (worst is None or size < worst[0]):
            worst = size, one
    return worst[1] if worst else None


def _tried(rows: FrictionRows, option: Option, bare: Columns, left: Rows) -> _Tried | None:
    """The variant of an option that explains most; None where there is nothing of it to see."""
    best: tuple[float, Variant, Columns] | None = None
    for variant in option.variants:
        F = bare[:, variant.columns]
        by = independent(F)
        if not by.shape[1] or (option.positive and F[:, 0] @ left <= 0):
            continue
        U = F @ by
        gain = float(np.sum((U.T @ left) ** 2))
        if best is None or gain > best[0]:
            best = gain, variant, U
    if best is None:
        return None
    _, variant, U = best
    judged = rows.judged(U, left, option.constants)
    seen = judged.surprise - _TRIALS
    large = rows.share(left - judged.after) > _LEAST
    return _Tried(
        option=option,
        variant=variant,
        gain=judged.gain,
        left=rows.share(judged.after),
        times=judged.times,
        surprise=seen,
        directions=U,
        useful=seen > _SEEN and large,
    )


def _record(one: _Tried, *, useful: bool) -> FrictionTrial:
    return FrictionTrial(
        joint=one.option.joint,
        addition=one.option.kind,
        error=one.left,
        gain=one.gain,
        significance=one.times,
        useful=useful,
    )
