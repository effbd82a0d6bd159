"""Nearest viscous and Coulomb friction, for programs without other friction terms.

Along a random motion within the robot's limits, drive torques τ_f of additional terms are

    τ_f ≈ Σ_J Y_viscous.J a_J + Y_coulomb.J b_J,   least squares over a, b ≥ 0

over the joints J that have such terms, so speeds and loads of the motion weigh the approximation.
`joint_forces` has the coefficients of joints for programs with viscous and Coulomb friction.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DeltaidError
from deltaid.kernel.batch import BLOCK
from deltaid.model.model import Model
from deltaid.motion.random_motion import random_motion
from deltaid.robot.friction_terms import FrictionTerm

_PLAIN = ("viscous", "coulomb")


def further_terms(model: Model) -> Iterator[FrictionTerm]:
    """Terms beyond viscous and Coulomb friction with a nonzero coefficient."""
    terms = model.robot.friction_terms
    return (term for term in terms if term.kind not in _PLAIN and model.value(term.name))


@dataclass(frozen=True)
class JointForces:
    """Coefficients of one joint, at the joint and not at the motor.

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
        target: name of a format that has only viscous·v + coulomb·sign(v), for messages.

    Raises:
        DeltaidError: a joint's friction law has other terms.
    """
    robot = subject.robot
    if term := next(further_terms(subject), None):
        raise DeltaidError(
            f"{target} has viscous and Coulomb friction only, but the model has {term.name}",
            where=subject.source,
            cure="approximate it, with the error stated (--plain-friction), or leave friction out "
            "(--without-friction) and add it as a joint torque there; c, fmu and casadi have "
            "every law",
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


def plain_friction(model: Model) -> tuple[Model, tuple[str, ...]]:
    """The model with the nearest viscous and Coulomb friction in place of additional terms, and the
    error in words; without such terms the model itself.

    Raises:
        KinematicsError: the described limits allow no motion.
    """
    joints = list(dict.fromkeys(term.joint for term in further_terms(model)))
    if not joints:
        return model, ()
    laws = {joint: model.robot.friction[joint].plain for joint in joints}
    robot = model.robot.changed(friction={**model.robot.friction, **laws})
    layout, dynamics = parameter_layout(robot), compiled(model.robot)
    names = [f"{kind}.{joint}" for kind in _PLAIN for joint in joints]
    p = np.array([0.0 if name in names else model.value(name) for name in layout.names])
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0.0, motion.period, BLOCK, endpoint=False))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, model.p)
    friction = tau - compiled(robot).torque(z, qd, qdd, p)
    columns = [layout.names.index(name) for name in names]
    load = dynamics.carried(z, qd, qdd, model.p) if robot.load_drives else None
    Y = compiled(robot).regressor_at(z, qd, qdd, load)[:, :, columns]
    p[columns], _ = nnls(Y.reshape(-1, len(columns)), friction.ravel())
    error = friction - Y @ p[columns]
    rms = np.sqrt(np.mean(error**2, axis=0))
    share = rms / np.sqrt(np.mean(tau**2, axis=0))
    k = int(np.argmax(share))
    unit = robot.units(robot.drives[k]).force
    altered = (*model.altered, "with viscous and Coulomb friction only")
    return replace(model, robot=robot, p=p, altered=altered), (
        f"friction of {', '.join(joints)} is approximated by viscous and Coulomb terms. Along a "
        f"random motion, {robot.drives[k]} is off by {rms[k]:.2g} {unit} rms ({share[k]:.2%} of "
        f"its torque), at most {np.abs(error[:, k]).max():.2g} {unit}",
    )
