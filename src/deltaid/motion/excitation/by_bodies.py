"""Motions compared by all that would be recorded along them: torques, sensors, measured values.

The search follows the criterion of torques, whose gradient is exact and cheap; which of the motions
that it finds from its starts is best, is decided by what all bodies would be known to.
"""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.motion.excitation.optimize import Judge
from deltaid.motion.fourier import FourierMotion
from deltaid.sensors.planning.goals import BODIES, goal
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.motion import PlannedMotion
from deltaid.sensors.planning.rows import Scene, torque_rows, torques
from deltaid.sensors.planning.unknowns import unknowns
from deltaid.sensors.planning.uses import described_rows
from deltaid.sensors.weighings import weighings

# Samples of a period, and the share of an entry that is known well enough with.
_SAMPLES, _ENOUGH = 1000, 1e-4


def by_bodies(dynamics: Dynamics, noise: Float[np.ndarray, " dof"], samples: float) -> Judge:
    """½ log det of the covariance of all bodies' entries [nats] after a recording of a motion.

    Args:
        noise: of torques [N m or N].
        samples: of the recording.

    Raises:
        DescriptionError: the robot's description has no sensors.
    """
    if not dynamics.robot.sensors:
        raise DescriptionError(
            "has no sensors to plan a motion for",
            where=dynamics.robot.name,
            cure="describe them under `sensors`, or leave out --for sensors",
        )
    p, entries = prior_parameters(dynamics.robot), unknowns(dynamics.robot)
    weighed = weighings(dynamics.robot)

    def judge(motion: FourierMotion) -> float:
        time = np.arange(_SAMPLES) * motion.period / _SAMPLES
        z, zd, zdd = motion.evaluate(time)
        _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
        planned = PlannedMotion("", motion.period, z, qd, qdd)
        scene = Scene(dynamics, p, planned, samples / _SAMPLES, noise)
        rows = torque_rows(scene, torques(dynamics, p, planned))
        known = Knowledge.before(len(entries.names)).and_rows(rows @ entries.W)
        known = known.and_rows(described_rows(scene, weighed)[0] @ entries.W)
        return goal(BODIES, entries, scene, _ENOUGH).left(known)

    return judge
