"""Which sensors the recordings have, and what these and measured values make free."""

from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np

from deltaid.estimation.additions import Addition
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.new_entries import with_new_entries
from deltaid.identification.sensor_columns import SensorColumns
from deltaid.identification.setup import Progress, Setup
from deltaid.model.parameter_record import Parameter
from deltaid.model.sensor_record import FittedChannel, FittedSensor
from deltaid.sensors.weighings import weighings

# Rounds at most until gain and pose of sensors stay, and the step, as a share of their priors'
# deviations, below which they do.
_ROUNDS, _SETTLED = 10, 1e-3


def fitted_sensors(problem: FittedProblem, judged: Sequence[Parameter]) -> tuple[FittedSensor, ...]:
    """The sensors of a fit as it found them.

    Args:
        judged: the parameters of all additions.
    """
    information, rest, found = problem.information, iter(judged), list[FittedSensor]()
    left, k = information.rms(problem.values), information.drives.stop
    for one in problem.additions:
        own = tuple(islice(rest, len(one.parameters)))
        if not isinstance(one, SensorColumns):
            continue
        at = range(k, k + len(one.rows.channels))
        k = at.stop
        channels = tuple(
            FittedChannel(
                name=channel.name,
                unit=channel.unit,
                stated=channel.noise,
                left=float(left[i]),
                largest=float(information.torque_max[i]),
            )
            for channel, i in zip(one.rows.channels, at, strict=True)
        )
        found.append(FittedSensor(name=one.rows.name, channels=channels, parameters=own))
    return tuple(found)


def sensors_settled(setup: Setup, progress: Progress) -> Setup:
    """Columns of gain and pose about what the fit gives, which is repeated until they stay."""
    if not any(isinstance(one, SensorColumns) and one.is_bilinear for one in setup.additions):
        return setup
    progress("settling gain and pose of sensors")
    for _ in range(_ROUNDS):
        problem = fit(setup.dynamics, setup.recordings, setup.settings, additions=setup.additions)
        known = dict(zip(problem.layout.names, problem.values.tolist(), strict=True))
        step = max(_step(one, known) for one in setup.additions)
        setup = setup.changed(
            additions=tuple(
                SensorColumns.of(setup.dynamics, one.rows.name, one.prior_spread, known)
                if isinstance(one, SensorColumns)
                else one
                for one in setup.additions
            )
        )
        if step < _SETTLED:
            break
    return setup


def _step(one: Addition, known: Mapping[str, float]) -> float:
    """How far a sensor's unknowns have moved, at most, as a share of their priors' deviations."""
    if not isinstance(one, SensorColumns):
        return 0.0
    moved = (
        abs(known[each.name] - one.known.get(each.name, each.prior))
        / (one.prior_spread * each.scale)
        for each in one.parameters
    )
    return max(moved, default=0.0)


def sensors_taken_in(setup: Setup, progress: Progress) -> Setup:
    """The sensors of the description that some recording has a column of, as part of the fit."""
    robot = setup.robot
    names = [
        name
        for name in robot.sensors
        if any(name in one.log.columns.sensor_names for one in setup.recordings)
    ]
    known = [np.flatnonzero(one.coefficients) for one in weighings(robot)]
    if not (names or known):
        return setup
    if names:
        progress(f"taking in {', '.join(names)}")
    spread, dynamics = setup.settings.prior_spread, setup.dynamics
    own = len(dynamics.layout.names)
    rows = [SensorColumns.of(dynamics, name, spread).rows for name in names]
    shown = np.concatenate([*known, *(one.pattern[1] for one in rows)])
    freed = with_new_entries(robot, np.unique(shown[shown < own]), dynamics.regressor_pattern[1])
    setup = setup.changed(robot=freed)
    sensors = tuple(SensorColumns.of(setup.dynamics, name, spread) for name in names)
    return setup.changed(additions=(*setup.additions, *sensors))
