"""Which friction law each joint needs, decided by cross-validation on the recordings themselves.

1. One pass over the data factors the robot's columns together with a dictionary: every term that a
   law may have (`robot/friction.py`), powers and Stribeck terms with a grid of their constants.
2. The blocks of the recordings make folds of consecutive stretches. For each fold a law is fitted
   to all others, friction coefficients positive and rigid-body columns free, and judged on the
   fold. Nonlinear constants are chosen anew in each fold, by the data that the fit may see.
3. Beginning with viscous and Coulomb friction everywhere, the addition that helps most is taken,
   as long as it lowers the error on the folds by more than chance.
4. The constants of the chosen laws are refined on finer grids, with all data; what the refined laws
   can do without is dropped again.

Everything but the passes works on triangular factors, whatever the number of samples.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.friction_options import (
    Options,
    additions,
    neighbours,
    only,
    plain_law,
    remaining,
)
from deltaid.identification.friction_search import (
    FrictionSearch,
    Laws,
    first_look,
    prepare,
    term_key,
)
from deltaid.identification.objective import NOISE_FLOOR
from deltaid.model.friction_record import AdditionKind, FrictionChoice, FrictionTrial
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, FrictionTerm

# An addition is taken when its gain is so many times the standard error of the gain over the folds:
# with some twenty additions tried at each step, chance alone seldom reaches it.
_SIGNIFICANT = 3.0
# Refinements: how often, and the ratio of neighbours on the first grid, whose root follows.
_TURNS, _SPACING = 4, 1.7


@dataclass(frozen=True)
class _Trial:
    """An addition to one joint's law with its errors on the folds."""

    joint: str
    addition: AdditionKind
    law: Friction
    errors: Float[np.ndarray, " folds"]
    gain: float
    significance: float


def choose_friction(
    robot: RobotDescription,
    recordings: Sequence[Recording],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[RobotDescription, FrictionChoice]:
    """The robot with the friction laws that its recordings ask for, and how they were chosen.

    Every joint of the description that has friction starts with its viscous and Coulomb
    coefficients; further terms of the description are dropped, and come back if the data wants
    them.

    Raises:
        IdentificationError: the motion does not determine the rigid-body parameters.
    """
    plain = _with_laws(robot, {j: plain_law(law) for j, law in robot.friction.items()})
    progress("preparing friction laws")
    speeds, p = first_look(plain, recordings)
    options = {
        j: additions(law, speeds[j], drive=j in robot.drives) for j, law in plain.friction.items()
    }
    tried = [(j, law) for j, kinds in options.items() for laws in kinds.values() for law in laws]
    search = prepare(plain, recordings, _further_terms(plain, tried), p)
    progress(f"trying {len(tried)} friction laws")
    steps, first = _extend(search, plain, options)
    laws = dict(plain.friction) | {step.joint: step.law for step in steps}
    search, laws = _refine(plain, recordings, laws, p, search, progress)
    kept = _thin_out(search, plain, laws, steps)
    laws = dict(plain.friction) | {j: only(laws[j], kept[j]) for j in kept}
    choice = FrictionChoice(
        folds=len(search.folds),
        plain_error=_share(search, _errors(search, plain, plain.friction)),
        chosen_error=_share(search, _errors(search, plain, laws)),
        steps=tuple(_record(s, search, useful=s.addition in kept[s.joint]) for s in steps),
        trials=tuple(_record(t, search, useful=_beyond_chance(t, search)) for t in first),
    )
    return _with_laws(robot, laws), choice


def _extend(
    search: FrictionSearch, robot: RobotDescription, options: dict[str, Options]
) -> tuple[list[_Trial], tuple[_Trial, ...]]:
    """Add what helps most until nothing helps; and the trials of the first round."""
    laws, steps, first = dict(robot.friction), [], ()
    while True:
        trials = _trials(search, robot, laws, options, _errors(search, robot, laws))
        first = first or trials
        useful = [trial for trial in trials if _beyond_chance(trial, search)]
        if not useful:
            return steps, first
        best = _simplest(max(useful, key=lambda trial: trial.gain), useful)
        steps.append(best)
        laws[best.joint] = best.law
        options[best.joint] = remaining(best.law, options[best.joint], best.addition)


def _thin_out(
    search: FrictionSearch, robot: RobotDescription, laws: Laws, steps: Sequence[_Trial]
) -> dict[str, set[AdditionKind]]:
    """For each joint the additions that its law cannot do without, with the refined constants."""
    kept: dict[str, set[AdditionKind]] = {j: set() for j in laws}
    for step in steps:
        kept[step.joint].add(step.addition)
    for step in reversed(steps):
        now = dict(laws) | {j: only(laws[j], kept[j]) for j in kept}
        fewer = kept[step.joint] - {step.addition}
        without = now | {step.joint: only(laws[step.joint], fewer)}
        errors = _errors(search, robot, now)
        gains = _errors(search, robot, without) - errors
        if not _significance(gains) > _SIGNIFICANT:
            kept[step.joint] = fewer
    return kept


def _trials(
    search: FrictionSearch,
    robot: RobotDescription,
    laws: Laws,
    options: Mapping[str, Options],
    before: Float[np.ndarray, " folds"],
) -> tuple[_Trial, ...]:
    """Every addition to every joint, judged on the folds."""
    trials = []
    for joint, kinds in options.items():
        for kind, variants in kinds.items():
            columns = [search.combination({**laws, joint: law}, robot) for law in variants]
            errors = search.errors(columns)
            gains = before - errors
            trials.append(
                _Trial(
                    joint=joint,
                    addition=kind,
                    law=variants[search.best(columns)],
                    errors=errors,
                    gain=float(gains.sum() / before.sum()) if before.sum() > 0 else 0.0,
                    significance=_significance(gains),
                )
            )
    return tuple(trials)


def _significance(gains: Float[np.ndarray, " folds"]) -> float:
    """Mean gain over the folds as a multiple of its standard error."""
    if len(gains) < 2 or not np.any(gains):
        return 0.0
    return float(gains.mean() / max(np.std(gains, ddof=1) / np.sqrt(len(gains)), 1e-300))


def _beyond_chance(trial: _Trial, search: FrictionSearch) -> bool:
    """Whether a gain is more than chance and than what torques can ever tell."""
    visible = trial.gain * _share(search, trial.errors) > NOISE_FLOOR
    return trial.significance > _SIGNIFICANT and visible


def _simplest(best: _Trial, useful: Sequence[_Trial]) -> _Trial:
    """A single term for the joint in place of a law for each direction, if it is as good."""
    singles = [
        trial
        for trial in useful
        if trial.joint == best.joint
        and trial.addition == "offset"
        and not _significance(trial.errors - best.errors) > _SIGNIFICANT
    ]
    return singles[0] if best.addition == "both_ways" and singles else best


def _errors(
    search: FrictionSearch, robot: RobotDescription, laws: Laws
) -> Float[np.ndarray, " folds"]:
    return search.errors([search.combination(laws, robot)])


def _refine(
    robot: RobotDescription,
    recordings: Sequence[Recording],
    laws: Laws,
    p: Parameters,
    search: FrictionSearch,
    progress: Callable[[str], None],
) -> tuple[FrictionSearch, dict[str, Friction]]:
    """Nonlinear constants on finer and finer grids about those chosen, joint by joint."""
    laws, spacing = dict(laws), _SPACING
    curved = [j for j, law in laws.items() if law.power or law.stribeck]
    for turn in range(_TURNS if curved else 0):
        progress(f"refining the constants of friction, {turn + 1} of {_TURNS}")
        near = {j: neighbours(laws[j], spacing) for j in curved}
        everything = [(j, law) for j in laws for law in (*near.get(j, ()), laws[j])]
        search = prepare(robot, recordings, _further_terms(robot, everything), p)
        for joint, variants in near.items():
            columns = [search.combination({**laws, joint: law}, robot) for law in variants]
            laws[joint] = variants[search.best(columns)]
        spacing **= 0.5
    return search, laws


def _further_terms(
    robot: RobotDescription, laws: Iterable[tuple[str, Friction]]
) -> tuple[FrictionTerm, ...]:
    """All terms of some joints' laws but viscous and Coulomb, each once."""
    terms = {
        term_key(term): term
        for joint, law in laws
        for term in _with_laws(robot, {joint: law}).friction_terms
        if term.kind not in ("viscous", "coulomb")
    }
    return tuple(terms.values())


def _with_laws(robot: RobotDescription, laws: Laws) -> RobotDescription:
    return robot.model_copy(update={"friction": dict(laws)})


def _share(search: FrictionSearch, errors: Float[np.ndarray, " folds"]) -> float:
    """Squared errors on the folds as a root mean square share of the largest torque."""
    return float(np.sqrt(errors.sum() / search.rows))


def _record(trial: _Trial, search: FrictionSearch, *, useful: bool) -> FrictionTrial:
    return FrictionTrial(
        joint=trial.joint,
        addition=trial.addition,
        error=_share(search, trial.errors),
        gain=trial.gain,
        significance=trial.significance,
        useful=useful,
    )
