"""Friction for programs that know viscous and Coulomb friction only: the nearest such law.

Along a random motion within the robot's limits, torques at the drives of further terms, τ_f, are

    τ_f ≈ Σ_J Y_viscous.J a_J + Y_coulomb.J b_J,   least squares over a, b ≥ 0

over the joints J that have such terms. Speeds and loads of the motion decide what is near.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import parameter_layout
from deltaid.model.model import Model
from deltaid.motion.random_motion import random_motion
from deltaid.robot.friction_terms import FrictionTerm

# Instants of the motion's period.
_INSTANTS = 2000
_PLAIN = ("viscous", "coulomb")


@dataclass(frozen=True)
class PlainFriction:
    """A model with viscous and Coulomb friction only.

    Attributes:
        model: the model; the one given where it has no further terms.
        warnings: what was approximated and how well; none where nothing was.
    """

    model: Model
    warnings: tuple[str, ...] = ()


def further_terms(model: Model) -> Iterator[FrictionTerm]:
    """Terms beyond viscous and Coulomb friction whose coefficient is not zero."""
    for term in model.robot.friction_terms:
        if term.kind not in _PLAIN and model.value(term.name):
            yield term


def plain_friction(model: Model) -> PlainFriction:
    """The model with the nearest viscous and Coulomb friction in place of further terms.

    Raises:
        KinematicsError: the described limits leave no room for a motion.
    """
    joints = list(dict.fromkeys(term.joint for term in further_terms(model)))
    if not joints:
        return PlainFriction(model)
    laws = {joint: model.robot.friction[joint].plain for joint in joints}
    robot = model.robot.changed(friction={**model.robot.friction, **laws})
    layout, dynamics = parameter_layout(robot), compiled(model.robot)
    names = [f"{kind}.{joint}" for kind in _PLAIN for joint in joints]
    p = np.array([0.0 if name in names else model.value(name) for name in layout.names])
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    instants = np.linspace(0.0, motion.period, _INSTANTS, endpoint=False)
    z, zd, zdd = motion.evaluate(instants)
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
    unit = "N" if robot.is_linear(robot.drives[k]) else "N m"
    warning = (
        f"friction of {', '.join(joints)} is approximated by viscous and Coulomb terms. Along a "
        f"random motion, {robot.drives[k]} is off by {rms[k]:.2g} {unit} rms ({share[k]:.2%} of "
        f"its torque), at most {np.abs(error[:, k]).max():.2g} {unit}"
    )
    altered = (*model.altered, "with viscous and Coulomb friction only")
    return PlainFriction(replace(model, robot=robot, p=p, altered=altered), (warning,))
