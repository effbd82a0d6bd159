"""What recordings say is held: found roughly before the fit, and told after it.

Before the fit, p_L is found roughly and its torques are taken out of the recordings, so that
whatever is done to these sees the robot alone; the columns of the fit (`effects.load_columns`) then
have p_L less what was taken out.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.load_columns import LoadColumns, Ten
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition, extended, of_each
from deltaid.estimation.posing import pose
from deltaid.estimation.reduction import build_reduction
from deltaid.identification.gathering import gather_all
from deltaid.identification.setup import Progress, Setup
from deltaid.model.model import Model
from deltaid.model.parameter_record import HeldLoad
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.carried import Load
from deltaid.recording.recording import Recording

# Of each recording its name, for messages, and the loads that it holds.
Held = Sequence[tuple[str, Sequence[Load]]]


def held(recordings: Sequence[Recording]) -> Held:
    """What recordings hold."""
    return [(str(one.path), one.log.columns.loads) for one in recordings]


def joined(holding: Held) -> tuple[Load, ...]:
    """The loads of recordings, one of each name, with all that is said of it anywhere.

    Raises:
        RecordingError: two recordings say different things of one load.
    """
    loads: dict[str, Load] = {}
    for where, own in holding:
        for load in own:
            before = loads.setdefault(load.name, load)
            for key, value in load.known.items():
                if before.known.get(key, value) != value:
                    raise RecordingError(
                        f"load {load.name} has another {key} than in the recording before",
                        where=where,
                        cure="say the same of it everywhere, or give two loads two names",
                    )
            loads[load.name] = before.changed(**load.known)
    return tuple(loads.values())


def declared_loads(setup: Setup, progress: Progress) -> Setup:
    """What the recordings' mappings say is held: known, or found roughly, and taken out."""
    loads = joined(held(setup.recordings))
    if not loads:
        return setup
    progress("finding what the robot carries")
    spread, none = setup.settings.prior_spread, np.zeros(10)
    columns = [LoadColumns(setup.dynamics, load, spread, none) for load in loads]
    found = [replace(one, taken=p) for one, p in zip(columns, _rough(setup, columns), strict=True)]
    taken = {one.load.name: one.taken for one in found}
    recordings = tuple(unloaded(one, taken) for one in setup.recordings)
    return setup.changed(recordings=recordings, additions=(*setup.additions, *found))


def unloaded(recording: Recording, loads: dict[str, Ten]) -> Recording:
    """A recording without the torques of the loads that it holds."""
    taken = tuple(tuple(loads[load.name].tolist()) for load in recording.log.columns.loads)
    if not taken:
        return recording
    return replace(recording, repairs=replace(recording.repairs, loads=taken))


def found_loads(
    additions: Sequence[Addition], judged: Sequence[Judged], holding: Held
) -> tuple[HeldLoad, ...]:
    """Loads of a fit's additions, with what it judged of all additions' parameters."""
    names = [(Path(where).name, {load.name for load in loads}) for where, loads in holding]
    return tuple(
        HeldLoad(
            name=one.load.name,
            body=one.body,
            logs=tuple(log for log, held in names if one.load.name in held),
            parameters=one.whole(own),
        )
        for one, own in of_each(additions, judged)
        if isinstance(one, LoadColumns)
    )


def known_load(columns: LoadColumns, model: Model, where: str) -> Ten:
    """p_L of a load as a model knows it, or as it is declared.

    Raises:
        RecordingError: neither.
    """
    known = {load.name: load.p for load in model.identified.loads} if model.identified else {}
    name = columns.load.name
    if name not in known and columns.load.mass is None:
        raise RecordingError(
            f"holds load {name}, which is not one of the model's",
            where=where,
            cure="call it as the recording did that the model was identified from, or give "
            "its mass in the mapping (load: {mass: …, centre: […]})",
        )
    return known.get(name, columns.prior)


def as_known(recording: Recording, model: Model) -> Recording:
    """A recording without the torques of loads that a model knows, or that are declared in full.

    Raises:
        RecordingError: one of the loads is neither.
    """
    loads, none = recording.log.columns.loads, np.zeros(10)
    columns = [LoadColumns(model.dynamics, load, model.prior_spread, none) for load in loads]
    where = str(recording.path)
    return unloaded(recording, {one.load.name: known_load(one, model, where) for one in columns})


def _rough(setup: Setup, columns: Sequence[LoadColumns]) -> list[Ten]:
    """p_L by the unconstrained minimum of (15): no lag, no contact, no friction law is known yet,
    so consistency is none of its business."""
    if all(one.is_fixed for one in columns):
        return [one.prior for one in columns]
    both = (*setup.additions, *columns)
    some = [one.brief for one in setup.recordings]
    prior = prior_parameters(setup.robot)
    information = gather_all(extended(setup.dynamics, both), some, prior).information
    added = [(one.parameters, one.free) for one in both]
    reduction = build_reduction(setup.robot, information.columns, added)
    objective = pose(information, reduction, setup.settings)
    _, gradient, hessian = objective.evaluate(reduction.prior)
    x = reduction.prior - np.linalg.solve(hessian, gradient)
    p = reduction.A @ x + reduction.p_0
    found = of_each(columns, p[len(p) - sum(len(one.parameters) for one in columns) :])
    return [one.prior if one.is_fixed else np.array(own) for one, own in found]
