"""What friction leaves of the drives' torques for motion."""

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.limits import torque_limits
from deltaid.errors import DeltaidError
from deltaid.robot.friction_terms import at_rest

# Length [m] by which a turning passive joint's friction becomes a force at the platform.
_LEVER = 0.1


def torques_without_friction(dynamics: Dynamics) -> dict[int, float]:
    """Torque limits less what Coulomb friction takes at the prior.

    The optimiser sees friction change its sign smoothly, which is less than the true friction at
    low speed; this much room covers the difference.

    Raises:
        DeltaidError: friction alone takes the whole torque.
    """
    robot = dynamics.robot
    arms = [limb.upper_arm or 1.0 for limb in robot.limb_geometry]
    # A passive joint's friction reaches a drive through a lever of about the arm's length.
    passive = sum(
        at_rest(law) / (1.0 if robot.is_linear(joint) else _LEVER)
        for joint, law in robot.friction.items()
        if joint not in robot.drives
    )
    left = {}
    for i, largest in torque_limits(robot).items():
        drive = robot.drives[i]
        law = robot.friction.get(drive)
        own = at_rest(law) + (law.load or 0.0) * largest if law else 0.0
        left[i] = largest - own - (passive * arms[i] if i < len(arms) else 0.0)
        if left[i] <= 0:
            unit, key = robot.units(drive).force, robot.units(drive).effort
            raise DeltaidError(
                f"a {key} limit of {largest:g} {unit} is no more than the joint's Coulomb friction",
                where=f"{robot.name}, drive_limits.{drive}.{key}",
                cure="raise the limit, or lower the friction's prior",
            )
    return left
