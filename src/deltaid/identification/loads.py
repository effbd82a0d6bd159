"""Declared loads: estimated roughly before the fit, and reported after it.

Before the fit, p_L is estimated roughly and its torques are subtracted from the recordings, so that
other stages work on the robot alone; the columns of the fit (`effects.load_columns`) then have p_L
less what was subtracted.
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
    return [(str(recording.path), recording.log.columns.loads) for recording in recordings]


def joined(holding: Held) -> tuple[Load, ...]:
    """The loads of recordings, one of each name, with all that is declared of it.

    Raises:
        RecordingError: two recordings contradict each other on one load.
    """
    loads: dict[str, Load] = {}
    for where, declared in holding:
        for load in declared:
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
    """Loads that mappings declare: known, or estimated roughly, and subtracted."""
    loads = joined(held(setup.recordings))
    if not loads:
        return setup
    progress("estimating what the robot carries")
    others = tuple(a for a in setup.additions if not isinstance(a, LoadColumns))
    setup = setup.changed(additions=others)
    spread, none = setup.settings.prior_spread, np.zeros(10)
    columns = [
        LoadColumns(setup.dynamics, load, spread, none, load.name in setup.detected)
        for load in loads
    ]
    rough = zip(columns, _rough(setup, columns), strict=True)
    additions = [replace(column, taken=p) for column, p in rough]
    taken = {column.load.name: column.taken for column in additions}
    recordings = tuple(unloaded(recording, taken) for recording in setup.recordings)
    return setup.changed(recordings=recordings, additions=(*setup.additions, *additions))


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
            name=addition.load.name,
            body=addition.body,
            logs=tuple(log for log, held in names if addition.load.name in held),
            parameters=addition.whole(fitted),
        )
        for addition, fitted in of_each(additions, judged)
        if isinstance(addition, LoadColumns)
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
    known = {column.load.name: known_load(column, model, where) for column in columns}
    return unloaded(recording, known)


def _rough(setup: Setup, columns: Sequence[LoadColumns]) -> list[Ten]:
    """p_L by the unconstrained minimum of (15): lags, contacts and friction laws are not known
    yet, so consistency does not help."""
    if all(column.is_fixed for column in columns):
        return [column.prior for column in columns]
    additions = (*setup.additions, *columns)
    some = [recording.brief for recording in setup.recordings]
    prior = prior_parameters(setup.robot)
    information = gather_all(extended(setup.dynamics, additions), some, prior).information
    added = [(addition.parameters, addition.free) for addition in additions]
    reduction = build_reduction(setup.robot, information.columns, added)
    objective = pose(information, reduction, setup.settings)
    _, gradient, hessian = objective.evaluate(reduction.prior)
    x = reduction.prior - np.linalg.solve(hessian, gradient)
    p = reduction.A @ x + reduction.p_0
    fitted = of_each(columns, p[len(p) - sum(len(column.parameters) for column in columns) :])
    return [column.prior if column.is_fixed else np.array(values) for column, values in fitted]
