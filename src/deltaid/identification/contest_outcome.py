"""Decisions of the contest of causes: which effects are kept, how large and how uncertain they are,
and whether the result stands or is refuted."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from deltaid.dynamics.dynamics import Parameters, compiled
from deltaid.effects.account import DETECTED
from deltaid.effects.all import UNKNOWNS
from deltaid.effects.lag_groups import agree, common_lag
from deltaid.effects.point import SIZE
from deltaid.effects.unexplained import UNEXPLAINED, in_words, is_unexplained, shares_of_torque
from deltaid.errors import Doubt
from deltaid.estimation.drive_rows import POSITION_ERROR, OfDrives
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.contest import Contest
from deltaid.identification.setup import (
    REFUTED,
    WIND_UP,
    Coefficients,
    ContestOutcome,
    Setup,
)
from deltaid.identification.study import ADEQUATE, beside_any_friction, left_of_a_drive
from deltaid.levels import NEAR
from deltaid.model.corrections import Inseparable, cause_in_words
from deltaid.model.verdict import listed, percent
from deltaid.robot.description import RobotDescription

# Key of the doubt that more effects than are corrected may act.
SUSPECTED = "suspected"
# Decades of improbability beyond which only "more than" is said.
_RAREST = 9.0


def decided(before: ContestOutcome, last: Contest, *, may_wind_up: bool) -> ContestOutcome:
    """The outcome of a reduced sweep: its steps added to the coefficients applied before.

    Args:
        may_wind_up: whether gears may become compliant. Compliant gears exclude rows near brakes; a
            compliance that only these rows show would come and go.
    """
    kept, values, deviations = last.shrunk.candidates, dict(before.values), {}
    gears = last.group(WIND_UP)
    is_shown = last.shrunk.surprise(gears) > DETECTED and last.shrunk.size(gears) > POSITION_ERROR
    winds_up = (may_wind_up or before.winds_up) and is_shown
    exact = (*kept, WIND_UP) if winds_up else kept
    for unknown in UNKNOWNS:
        if not (unknown.corrects or unknown.name == WIND_UP):
            continue
        if unknown.name not in exact:
            values.pop(unknown.name, None)
            continue
        group = last.group(unknown.name)
        values[unknown.name] = unknown.possible(last.shrunk.x[group.columns] - group.mean)
        deviations[unknown.name] = last.shrunk.deviation(group)
    if winds_up:
        values[WIND_UP] = _wound(before.described, last, values[WIND_UP])
    recordings = tuple(point.trace.recording.log.sha256 for point in last.points)
    return ContestOutcome(
        before.described, kept, values, deviations, recordings, doubts=before.doubts
    )


def _wound(robot: RobotDescription, last: Contest, compliance: Coefficients) -> Coefficients:
    """Compliances of gears, equal for identical limbs unless estimates contradict that; 0 within
    one standard deviation."""
    group, count = last.group(WIND_UP), len(robot.identical_drives)
    if count:
        own = group.columns[:count]
        covariance = last.shrunk.covariance[np.ix_(own, own)] * last.shrunk.level(group)
        if agree(compliance[:count], covariance):
            common = common_lag(compliance[:count], covariance)[0]
            compliance = np.append(np.full(count, common), compliance[count:])
    return np.where(compliance > last.shrunk.deviation(group), compliance, 0.0)


def is_settled(before: ContestOutcome, after: ContestOutcome) -> bool:
    same = before.kept == after.kept and before.values.keys() == after.values.keys()
    return same and all(
        np.all(np.abs(values - before.values[name]) <= NEAR * after.deviations[name])
        for name, values in after.values.items()
    )


def doubted(outcome: ContestOutcome, full: Contest, last: Contest) -> ContestOutcome:
    """The outcome with moves that widen intervals, and pairs of causes that rows do not separate.

    Each of n dropped effects widens intervals by the change of parameters with it and by its own
    uncertainty, times the root of its probability beside the kept effects. Its prior odds are
    1 : n, for hardly more than one of them acts.
    """
    rivals = full.rivals(last)
    suspects, torques = full.suspects(last), last.unexplained_torques()
    exact = (*outcome.kept, *outcome.values)
    held = [u.name for u in UNKNOWNS if u.name in exact and not u.is_fitted]
    moves = [*last.follows(held), *(rival.estimate - last.estimate for rival in rivals.values())]
    for name, suspect in suspects.items():
        weight = np.sqrt(expit(suspect.odds(last) - np.log(len(suspects))))
        move = suspect.estimate - last.estimate
        moves += [weight * move, *(weight * m for m in suspect.follows([name]))]
    if torques is not None:  # they may be in proportion to the robot's torques
        doubt = _unexplained(last, torques)  # suspects may be a part of these
        moves.append(float(shares_of_torque(last.points[0], torques).max()) * last.estimate)
    else:
        surprises = {
            name: suspect.shrunk.surprise(suspect.group(name))
            for name, suspect in suspects.items() if suspect.is_certain(name, last)
        }  # fmt: skip
        doubt = _suspicion(surprises)
    return replace(
        outcome,
        moves=tuple(last.named(move) for move in moves),
        inseparable=tuple(
            Inseparable(causes=(cause_in_words(cause), cause_in_words(other)))
            for cause, other in rivals
        ),
        doubts=_of_limits(outcome) | doubt,
    )


def _unexplained(last: Contest, torques: OfDrives) -> dict[str, str]:
    """A doubt about torques that only free functions explain: of the drive with the largest share,
    and of the function that the rows need most."""
    shares = shares_of_torque(last.points[0], torques)
    drive = int(np.argmax(shares))
    name = last.points[0].drives[drive]
    free = [group for group in last.shrunk.droppable if is_unexplained(group.name)]
    follows = max(free, key=last.shrunk.price).name.removeprefix(f"{UNEXPLAINED} ")
    doubt = Doubt(
        in_words(float(shares[drive]), name, f"it varies with {follows}")
        + "; no known effect explains it, and the model excludes it",
        cause="something acts on the robot or its sensors that deltaid has no effect of",
        cure="look at hoses, drives and sensors for what varies so; the residual over time is in "
        "the report",
    )
    return {UNEXPLAINED: doubt}


def _suspicion(surprises: Mapping[str, float]) -> dict[str, str]:
    """A doubt about suspects, by the surprise of each [decades]."""
    if not surprises:
        return {}
    names = sorted(surprises, key=lambda name: -surprises[name])
    causes, largest = _named(names, "or"), surprises[names[0]]
    rare = "more than " * (largest > _RAREST)
    doubt = Doubt(
        f"{causes} may also act: chance explains as much in one of {rare}"
        f"{10 ** min(largest, _RAREST):,.0f} recordings; too little evidence to correct it, so "
        "intervals include it",
        cause=f"a small error or effect ({causes}), or something unknown that looks like it",
        cure="record a longer or faster motion, which decides it",
    )
    return {SUSPECTED: doubt}


def _of_limits(outcome: ContestOutcome) -> dict[str, str]:
    """Doubts about effects beyond their limits."""
    others = {SUSPECTED, UNEXPLAINED}
    return {key: doubt for key, doubt in outcome.doubts.items() if key not in others}


def beyond_parts(last: Contest) -> frozenset[str]:
    """Errors of the description beyond any tolerance of parts that are kept beside other effects.

    A gross error explains everything by itself; one that needs others imitates something else.
    """
    kept, robot = last.shrunk.candidates, last.rows.dynamics.robot
    return frozenset(
        unknown.name for unknown in UNKNOWNS
        if len(kept) > 1 and unknown.name in kept and unknown.is_of_parts
        and last.shrunk.is_beyond(last.group(unknown.name), unknown.stated(robot))
    )  # fmt: skip


def why_not(setup: Setup, beyond: Collection[str]) -> str:
    """Why the kept effects are refuted; empty where they stand."""
    if beyond:
        return f"{_named(sorted(beyond))} would exceed any plausible error"
    studies = [study for study in setup.studies if study]
    left = max(map(left_of_a_drive, studies), default=0.0)
    is_free = setup.outcome is not None and any(map(is_unexplained, setup.outcome.kept))
    # Friction laws are chosen later; free functions and friction of any law explain anything.
    if left > ADEQUATE and not is_free:
        left = max(left_of_a_drive(beside_any_friction(study)) for study in studies)
    return f"{percent(left)} of a drive's torque would remain" if left > ADEQUATE else ""


def overtaken(last: Contest, beside: Contest) -> str:
    """Why free functions are refuted: they take a larger share of the model's torques than an
    undescribed effect usually makes (95 %); empty where they do not."""
    point = beside.points[0]
    change = point.trace.model(beside.p) - point.trace.model(last.p)
    share = float(shares_of_torque(point, change).max())
    return (
        f"they would explain {percent(share)} of a drive's torque" if share > NORMAL * SIZE else ""
    )


def refuted(outcome: ContestOutcome, why: str, moves: Sequence[Parameters]) -> ContestOutcome:
    """The outcome without corrections, with a doubt that names what was refuted.

    Args:
        moves: changes of the parameters by the refuted corrections.
    """
    every = dict.fromkeys((*outcome.kept, *outcome.values))
    named = [name for name in every if not is_unexplained(name)]
    tried = f"corrections of {_named(named)}" if named else "free functions of the drives' torques"
    doubt = (
        f"something acts on the robot that no known effect explains: with {tried}, {why}. Nothing "
        "of it is corrected; intervals include what these would change"
    )
    layout = compiled(outcome.described).layout
    uncorrected = (layout.named(move) for move in moves)
    return ContestOutcome(
        outcome.described,
        moves=(*outcome.moves, *uncorrected),
        doubts=_of_limits(outcome) | {REFUTED: doubt},
    )


def _named(effects: Collection[str], conjunction: str = "and") -> str:
    """The kinds of these effects in words, each once."""
    kinds = dict.fromkeys(name.split(" of ")[0] for name in effects)
    return listed([cause_in_words(kind) for kind in kinds], conjunction)
