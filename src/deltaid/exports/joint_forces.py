"""What a joint feels beside rigid bodies, for programs with viscous and dry friction."""

from dataclasses import dataclass

from deltaid.errors import DeltaidError
from deltaid.model.model import Model


@dataclass(frozen=True)
class JointForces:
    """Coefficients of one joint, all at the joint and not at the motor.

    Attributes:
        viscous: [N m s/rad or N s/m].
        coulomb: [N m or N].
        armature: inertia of motor and gear [kg m² or kg].
        stiffness, rest: linear spring [N m/rad or N/m], coordinate without force [rad or m].
    """

    viscous: float = 0.0
    coulomb: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


def joint_forces(subject: Model, target: str) -> dict[str, JointForces]:
    """Coefficients of the joints of a description.

    Args:
        target: whose only friction is viscous·v + coulomb·sign(v); for messages.

    Raises:
        DeltaidError: a joint's friction law has other terms.
    """
    robot = subject.robot
    for term in robot.friction_terms:
        if term.kind not in ("viscous", "coulomb") and subject.value(term.name):
            raise DeltaidError(
                f"{target} has viscous and Coulomb friction only, but the model has {term.name}",
                where=subject.source,
                cure="leave friction out (--without-friction) and add it as a joint torque there, "
                "or identify with viscous and Coulomb friction; c, fmu and casadi have every law",
            )
    return {
        joint: JointForces(
            viscous=subject.value(f"viscous.{joint}"),
            coulomb=subject.value(f"coulomb.{joint}"),
            armature=subject.value(f"rotor.{joint}"),
            stiffness=subject.value(f"spring.{joint}"),
            rest=robot.spring_rest(joint) if joint in robot.spring_joints else 0.0,
        )
        for joint in robot.joints
    }
