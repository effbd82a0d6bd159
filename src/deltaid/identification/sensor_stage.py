"""Which sensors the recordings have, and what these and measured values make free.

What `free` excludes of a body costs a fit of torques nothing where torques do not determine it. A
new row that does would take it for known exactly, and all intervals would be too narrow. So it
varies around the prior as it was before the reduction. An entry that torques determine and that is
not free is a statement of the description, and stays; so does a body with `free: []`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.additions import Addition, extended, of_each
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.measured_rows import MeasuredRows, SensorAddition
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import FittedChannel, FittedSensor
from deltaid.model.parameter_record import Parameter
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, entry_map
from deltaid.sensors.weighings import weighings

# Rounds at most until gain and pose of sensors stay, and the step, as a share of their priors'
# deviations, below which they do.
_ROUNDS, _SETTLED = 10, 1e-3


def sensors_included(setup: Setup, progress: Progress) -> Setup:
    """The sensors of the description that some recording has a column of, as part of the fit."""
    robot, dynamics, spread = setup.robot, setup.dynamics, setup.settings.prior_spread
    recorded = {
        sensor.name for recording in setup.recordings for sensor in recording.log.columns.sensors
    }
    names, known = [name for name in robot.sensors if name in recorded], weighings(robot)
    if not (names or known):
        return setup
    if names:
        progress(f"taking in {', '.join(names)}")
    sensors = [SensorAddition.for_sensor(dynamics, name, spread) for name in names]
    shown = MeasuredRows(extended(dynamics, sensors), known).active
    setup = setup.changed(robot=with_new_entries(robot, shown, dynamics.regressor_pattern[1]))
    sensors = tuple(SensorAddition.for_sensor(setup.dynamics, name, spread) for name in names)
    return setup.changed(additions=(*setup.additions, *sensors))


def with_new_entries(
    robot: RobotDescription,
    shown: Int[np.ndarray, " shown"],
    by_torques: Int[np.ndarray, " visible"],
) -> RobotDescription:
    """A description in which all is free that only sensors and measured values determine: entries
    of M̄ that the parameters consist of that these, `shown`, determine and torques do not."""
    layout, bodies = parameter_layout(robot), dict(robot.bodies)
    new = np.isin(np.arange(len(layout.names)), np.setdiff1d(shown, by_torques))
    for name in layout.bodies:
        consists = np.any(entry_map()[new[layout.body(name)]] != 0, axis=0)
        free = bodies[name].free
        pairs = zip(PSEUDO_INERTIA_ENTRIES, consists, strict=True)
        entries = tuple(entry for entry, of_new in pairs if of_new or entry in free)
        if free and set(entries) != set(free):
            bodies[name] = bodies[name].changed(free=entries)
    return robot if bodies == robot.bodies else robot.changed(bodies=bodies)


def sensors_settled(setup: Setup, progress: Progress) -> Setup:
    """Columns of gain and pose about what the fit gives, which is repeated until they stay."""
    sensors = [sensor for sensor in setup.additions if isinstance(sensor, SensorAddition)]
    if not any(sensor.is_bilinear for sensor in sensors):
        return setup
    progress("settling gain and pose of sensors")
    for _ in range(_ROUNDS):
        problem = fit(setup.dynamics, setup.recordings, setup.settings, additions=setup.additions)
        known = dict(zip(problem.layout.names, problem.values.tolist(), strict=True))
        steps, additions = list[float](), list[Addition]()
        for addition in setup.additions:
            if isinstance(addition, SensorAddition):
                steps += [
                    abs(known[entry.name] - addition.known.get(entry.name, entry.prior))
                    / (addition.prior_spread * entry.scale)
                    for entry in addition.parameters
                ]
                name, spread = addition.rows.name, addition.prior_spread
                addition = SensorAddition.for_sensor(setup.dynamics, name, spread, known)
            additions.append(addition)
        setup = setup.changed(additions=tuple(additions))
        if max(steps) < _SETTLED:
            break
    return setup


def fitted_sensors(problem: FittedProblem, judged: Sequence[Parameter]) -> tuple[FittedSensor, ...]:
    """The fitted sensors, by the judged parameters of all additions."""
    information, sensors = problem.information, list[FittedSensor]()
    rows = np.stack([information.rms(problem.values), information.torque_max], axis=1)
    sizes = iter(rows[information.drives.stop :].tolist())
    for sensor, fitted in of_each(problem.additions, judged):
        if not isinstance(sensor, SensorAddition):
            continue
        channels = tuple(
            FittedChannel(name=c.name, unit=c.unit, stated=c.noise, left=left, largest=largest)
            for c, (left, largest) in zip(sensor.rows.channels, sizes, strict=False)
        )
        sensors.append(FittedSensor(name=sensor.rows.name, channels=channels, parameters=fitted))
    return tuple(sensors)
