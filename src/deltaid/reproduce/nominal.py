"""The robot of Sec. VII: its true ("nominal") parameters and regularisations below and above them.

The paper prints its nominal bodies only as bars of Fig. 3. Those here are near the values that it
identified for the real robot (Table I, columns ID), each body physically consistent and without a
symmetry that its reduction does not ask for. Friction is the paper's for the drives (Sec. VII); for
the telescope's slide, of which Sec. VII gives no value, it is that of Sec. VIII B.
"""

import numpy as np

from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.inertia import RigidBody, inertia_parameters

# Mass [kg], first moment [kg m] and second moments ∫x², ∫y², ∫z² dm [kg m²] in the link frame.
_BODIES = {
    "U": (1.0, (0.130, 0.0, -0.020), (0.1400, 0.0008, 0.0060)),
    "S": (0.25, (0.105, 0.0, 0.0), (0.0855, 0.0007, 0.0004)),
    "P": (1.0, (0.0, 0.0, 0.0), (6e-4, 6e-4, 1e-4)),
    "TU": (0.9, (0.0, 0.0, -0.300), (1.9e-5, 1.3e-5, 0.150)),
    "TL": (0.5, (0.0, 0.0, 0.240), (5.0e-5, 3.5e-5, 0.130)),
    "EE": (0.35, (0.004, -0.006, 0.0), (2.0e-4, 1.4e-4, 5.0e-4)),
}
# Viscous and Coulomb friction: Sec. VII for the drives, Sec. VIII B for the slide.
_FRICTION = {
    "drive1": (2.0, 4.0),
    "drive2": (2.0, 4.0),
    "drive3": (2.0, 4.0),
    "drive4": (0.5, 1.0),
    "slide": (4.08, 5.36),
}
_ROTOR = 2.87e-3  # Sec. VIII B [kg m²]

ROBOT = "irb360-6-1600"
# Shares of the truth between which the regularisations lie.
BELOW, ABOVE = (0.6, 0.8), (1.25, 1.6)


def nominal_robot(robot: RobotDescription) -> RobotDescription:
    """The catalogue's robot with the nominal parameters as its prior: the truth."""
    return robot.changed(
        name=f"{robot.name}-nominal",
        bodies={
            name: robot.bodies[name].changed(prior=ExplicitInertia.of(_body(*values)))
            for name, values in _BODIES.items()
        },
        friction={j: Friction(viscous=v, coulomb=c) for j, (v, c) in _FRICTION.items()},
        rotor_inertia={"drive4": _ROTOR},
        sources={},
    )


def regularisation(
    nominal: RobotDescription, name: str, share: tuple[float, float], rng: np.random.Generator
) -> RobotDescription:
    """The same robot with a prior of which every entry is a share of the truth between two bounds.

    Each body's pseudo-inertia matrix becomes G M̄ G with a random diagonal G, so it stays consistent
    and its entries do not keep their proportions.
    """
    bodies = {}
    for body, given in nominal.bodies.items():
        G = np.diag(np.sqrt(rng.uniform(*share, 4)))
        prior = RigidBody(given.prior_parameters()).transformed(G).p
        bodies[body] = given.changed(prior=ExplicitInertia.of(prior))
    friction = {
        joint: Friction(
            viscous=law.viscous * rng.uniform(*share), coulomb=law.coulomb * rng.uniform(*share)
        )
        for joint, law in nominal.friction.items()
    }
    rotors = {drive: I * rng.uniform(*share) for drive, I in nominal.rotor_inertia.items()}
    return nominal.changed(name=name, bodies=bodies, friction=friction, rotor_inertia=rotors)


def _body(
    mass: float, first_moment: tuple[float, ...], second_moments: tuple[float, ...]
) -> np.ndarray:
    M = np.diag([*second_moments, mass])
    M[:3, 3] = M[3, :3] = first_moment
    return inertia_parameters(M)
