"""Choice of each joint's friction law by the residual of the described one.

1. The residual is that of the recordings' rows with the robot's parameters and a lag of each
   drive (`friction_rows`). If no additional term of any joint explains more than chance, laws stay
   as described.
2. The most surprising term is added, then that of the remaining residual, and so on. Described
   terms stay. Drives of identical limbs are alike: a term that one of them got need only be
   probable for the others (95 %).
3. Gauss–Newton refines the constants of added terms together with all coefficients, within their
   bounds (`friction_constants`).
4. Added terms that the refined laws do not need are dropped. There is no second round: it would
   only fit noise.
5. Drives of identical limbs get offsets together where none alone is surprising, for weight of
   all limbs looks like their mean; where some have a constant, the others get an offset if that
   explains more than chance.

Chance is the larger of scatter between stretches of time and white noise.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.effects.lag_columns import TimingColumns
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.problem import Columns, Rows, independent, lengths
from deltaid.estimation.scatter import NORMAL, surprise
from deltaid.identification.common_constant import missing_offsets, undetected_constant
from deltaid.identification.friction_constants import (
    SELDOM,
    LawConstants,
    Refined,
    refined,
    surprise_of_more,
)
from deltaid.identification.friction_rows import (
    FrictionRows,
    JudgedColumns,
    Variant,
    friction_rows,
    options,
    shapes_of,
)
from deltaid.identification.gains import shown_by_torques
from deltaid.identification.setup import Progress, Setup
from deltaid.levels import ROUNDS
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import FrictionChoice, FrictionTrial, JointTerm
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import law_in_words

# Least surprise of an added term [decades]: 1.3 more for some twenty joints and kinds of terms.
SURPRISING = SELDOM + 1.3
# Surprise that chance exceeds in one of twenty recordings [decades].
_PROBABLE = surprise(NORMAL**2, 1)


def rows_for_friction(setup: Setup, progress: Progress, clause: str) -> FrictionRows | None:
    """Rows in which friction is searched; None where described laws are kept, a load is undeclared,
    or recordings are too short, which the fit reports."""
    if setup.settings.friction != "choose" or not setup.robot.friction:
        return None
    if any(setup.disturbed):
        return None
    progress(f"looking for friction that {clause}")
    additions = shown_by_torques(setup.without(TimingColumns).additions)
    try:
        return friction_rows(setup.dynamics, setup.recordings, additions)
    except RecordingError:
        return None


def chosen_friction(setup: Setup, progress: Progress) -> Setup:
    """The stage that chooses friction laws, unless described ones are to be kept."""
    rows = rows_for_friction(setup, progress, "the description lacks")
    if rows is None:
        return setup
    robot, choice = choose_friction(rows, progress, setup.barred)
    setup = setup.with_robot(robot).reported(_corrections(setup.robot, robot, choice), "friction")
    constants = LawConstants(setup.dynamics)
    added = (constants,) if constants.parameters else ()
    return setup.changed(
        friction_choice=choice,
        additions=(*setup.additions, *added),
        undetected=undetected_constant(rows, robot),
    )


def _corrections(
    before: RobotDescription, after: RobotDescription, choice: FrictionChoice
) -> list[Correction]:
    corrections = list[Correction]()
    for joint, law in after.friction.items():
        steps = [step for step in choice.steps if step.useful and step.joint == joint]
        if law == before.friction[joint]:
            continue
        reason = "other limbs' drives have a constant, and what is common to all looks like weight"
        if steps:
            remaining = float(np.prod([1 - step.gain for step in steps]))
            times = max(step.significance for step in steps)
            reason = (
                f"squared errors of the torques fall by {100 * (1 - remaining):.2g} %, {times:.2g} "
                "times what chance would explain"
            )
        laws = f"{law_in_words(law)}, no longer {law_in_words(before.friction[joint])}"
        text = f"friction law {laws}: {reason}"
        corrections.append(Correction(kind="friction", subject=joint, text=text))
    return corrections


@dataclass(frozen=True, eq=False)
class _Step:
    """The variant of an additional term that explains most, with what it explains."""

    variant: Variant
    judged: JudgedColumns
    is_shared: bool = False  # drives of the same make have such a term

    @property
    def joint(self) -> str:
        return self.variant.joint.name

    @property
    def is_useful(self) -> bool:
        """Whether it is beyond chance, and large enough to matter."""
        is_large = self.judged.is_large or self.is_shared
        return self.judged.surprise > self.least_surprise and is_large

    @property
    def least_surprise(self) -> float:
        return _PROBABLE if self.is_shared else SURPRISING

    def trial(self, *, useful: bool) -> FrictionTrial:
        return FrictionTrial(
            joint=self.joint,
            addition=self.variant.kind,
            error=self.judged.error,
            gain=self.judged.gain,
            significance=self.judged.times,
            useful=useful,
        )


@dataclass(frozen=True, eq=False)
class _TermSearch:
    """Columns of variants and torques, both less their explained part."""

    rows: FrictionRows
    bare: dict[Variant, Columns]
    residual: Rows

    @classmethod
    def begun(cls, rows: FrictionRows, variants: Sequence[Variant]) -> "_TermSearch":
        """The search with parameters, additions and lags alone."""
        columns = rows.columns([(form.joint, shape) for form in variants for shape in form.shapes])
        ends = np.cumsum([len(variant.shapes) for variant in variants])[:-1]
        bare = np.split(rows.span.without(columns / lengths(columns)), ends, axis=1)
        return cls(rows, dict(zip(variants, bare, strict=False)), rows.residual)

    def without(self, U: Columns) -> "_TermSearch":
        bare = {variant: A - U @ (U.T @ A) for variant, A in self.bare.items()}
        return _TermSearch(self.rows, bare, self.residual - U @ (U.T @ self.residual))

    def step(self, option: Sequence[Variant], others: Iterable[_Step] = ()) -> _Step | None:
        """The variant of one term that explains most; None where none is identifiable."""
        most, best = -1.0, None
        for variant in option:
            A = self.bare[variant]
            U = A @ independent(A)
            gain = float(np.sum((U.T @ self.residual) ** 2))
            is_possible = not variant.positive or A[:, 0] @ self.residual > 0
            if U.shape[1] and is_possible and gain > most:
                most, best = gain, (variant, U)
        if best is None:
            return None
        variant, U = best
        is_shared = variant.term in shared_terms(
            self.rows.dynamics.robot, (other.variant.term for other in others)
        )
        return _Step(variant, self.rows.judged(U, self.residual, variant.constants), is_shared)


def shared_terms(robot: RobotDescription, terms: Iterable[JointTerm]) -> set[JointTerm]:
    """The same terms for the other drives of identical limbs."""
    drives = robot.identical_drives
    return {
        (drive, kind) for joint, kind in terms if joint in drives
        for drive in drives if drive != joint
    }  # fmt: skip


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def choose_friction(
    rows: FrictionRows, progress: Progress = lambda _: None, barred: Collection[JointTerm] = ()
) -> tuple[RobotDescription, FrictionChoice]:
    """The robot with the friction laws that its recordings need, and how they were chosen."""
    robot = rows.dynamics.robot
    steps, first = _extended(rows, barred)
    # Gears keep the inertia that load friction was fitted with.
    loaded = [step.variant.joint for step in steps if step.variant.kind == "load"]
    rows = replace(rows, moved={joint.name: joint.moved for joint in loaded})
    kept, refit = _refined(rows, steps, progress)
    refit = _with_constants(rows, kept, refit)
    return robot.changed(friction=dict(robot.friction) | refit.laws), FrictionChoice(
        folds=STRETCHES,
        plain_error=rows.share(rows.residual),
        chosen_error=rows.share(refit.residual),
        steps=tuple(step.trial(useful=step in kept) for step in steps),
        trials=tuple(step.trial(useful=step.is_useful) for step in first),
    )


def _extended(rows: FrictionRows, barred: Collection[JointTerm]) -> tuple[list[_Step], list[_Step]]:
    """Add the most surprising term until none is significant; and the first round's trials."""
    candidates = [option for option in options(rows) if option[0].term not in barred]
    search = _TermSearch.begun(rows, [variant for option in candidates for variant in option])
    steps, first = list[_Step](), list[_Step]()
    for _ in range(ROUNDS):
        trials = [step for option in candidates if (step := search.step(option, steps))]
        first = first or trials
        useful = [step for step in trials if step.is_useful]
        if not useful:
            break
        best = max(useful, key=lambda step: step.judged.surprise)
        if best.variant.kind == "both_ways":
            best = _simplest(best, useful, search, steps)
        steps.append(best)
        added = {best.variant.term}
        if best.variant.kind == "both_ways":  # laws for both directions include an offset
            added.add((best.joint, "offset"))
        candidates = [option for option in candidates if option[0].term not in added]
        search = search.without(best.judged.directions)
    return [*steps, *_common_offsets(search, candidates, steps)], first


def _common_offsets(
    search: _TermSearch, candidates: Iterable[Sequence[Variant]], steps: Sequence[_Step]
) -> list[_Step]:
    """Offsets of all drives of identical limbs, if none has a constant and only their sum is beyond
    chance."""
    drives = search.rows.dynamics.robot.identical_drives
    offsets = [
        variants[0] for variants in candidates
        if variants[0].kind == "offset" and variants[0].joint.name in drives
    ]  # fmt: skip
    if not drives or len(offsets) < len(drives):
        return []
    A = np.hstack([search.bare[offset] for offset in offsets])
    U = A @ independent(A)
    if not U.shape[1]:
        return []
    judged = search.rows.judged(U, search.residual, 0)
    together = [_Step(offset, judged) for offset in offsets]
    return together if together[0].is_useful else []


def _simplest(
    both: _Step, useful: Sequence[_Step], search: _TermSearch, steps: Sequence[_Step]
) -> _Step:
    """An offset in place of a law for each direction, if that explains no more than by chance."""
    for offset in useful:
        if offset.variant.term == (both.joint, "offset"):
            more = search.without(offset.judged.directions).step([both.variant], steps)
            return both if more is not None and more.is_useful else offset
    return both


def _refined(
    rows: FrictionRows, steps: Sequence[_Step], progress: Progress
) -> tuple[list[_Step], Refined]:
    """Steps that are kept, and the laws with refined constants."""
    kept = list(steps)
    while kept:
        progress(f"refining friction laws of {len({step.joint for step in kept})} joints")
        refit = refined(rows, _laws(rows, kept))
        spare = _spare(rows, kept, refit)
        if spare is None:
            return kept, refit
        kept.remove(spare)
    return [], Refined({}, rows.residual)


def _laws(
    rows: FrictionRows, steps: Iterable[_Step], constants: Iterable[Variant] = ()
) -> dict[str, Friction]:
    laws = dict[str, Friction]()
    variants = [*constants, *(step.variant for step in steps)]
    for variant in sorted(variants, key=lambda variant: variant.kind != "offset"):
        joint = variant.joint.name
        before = laws.get(joint, rows.dynamics.robot.friction[joint])
        laws[joint] = before.changed(**variant.more)
    return laws


def _with_constants(rows: FrictionRows, kept: Sequence[_Step], refit: Refined) -> Refined:
    """Add offsets to the limbs' other drives where a constant is chosen, unless they explain no
    more than chance (95 %).

    A constant common to all drives is like a weight of the limbs, which would otherwise absorb the
    constant of a drive without an offset.
    """
    if not (offsets := missing_offsets(rows, refit.laws)):
        return refit
    complete = refined(rows, _laws(rows, kept, offsets))
    surprising = surprise_of_more(rows, complete, refit, len(offsets))
    return complete if surprising > _PROBABLE else refit


def _spare(rows: FrictionRows, steps: Sequence[_Step], refit: Refined) -> _Step | None:
    """The step that refined laws need least, judged with all others; None if all are needed."""
    robot, forms = rows.dynamics.robot, dict[_Step, Variant]()
    for step in steps:
        shapes = shapes_of(robot, step.joint, refit.laws[step.joint], step.variant.kind)
        forms[step] = replace(step.variant, shapes=shapes, positive=False)
    search, surprises = _TermSearch.begun(rows, list(forms.values())), dict[_Step, float]()
    for step, form in forms.items():
        others = np.hstack([A * (variant is not form) for variant, A in search.bare.items()])
        rest = search.without(others @ independent(others))
        now = rest.step([form], (other for other in steps if other is not step))
        if now is None or not now.is_useful:
            surprises[step] = now.judged.surprise if now is not None else 0.0
    return min(surprises, key=lambda step: surprises[step], default=None)
