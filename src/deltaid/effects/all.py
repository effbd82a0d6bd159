"""All effects: a study searches `EFFECTS` in the residual, the contest fits `UNKNOWNS` and effects
`ALONG_MOTION` together.

To delete an effect, delete its file and its lines here; the others keep working.
"""

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.along_motion import AlongMotion, FittedTorques
from deltaid.effects.at_drives import DriveSpring, RippleColumns
from deltaid.effects.at_platform import FORCES, Cable, platform_forces
from deltaid.effects.ball_joints import BallJointFriction, RubbingJoints, of_ball_joints
from deltaid.effects.delay import Delay
from deltaid.effects.drift import Drift
from deltaid.effects.effect import Cause, Effect
from deltaid.effects.friction import (
    FrictionByDirection,
    FrictionByLoad,
    FrictionLaw,
    FrictionOverSpeed,
)
from deltaid.effects.gain import Gain
from deltaid.effects.gain_over_time import GainOverTime
from deltaid.effects.geometry import GearRatios, Lengths, Structure, Tilt, Zeros
from deltaid.effects.limbs import UnlikeLimbs
from deltaid.effects.load import LoadChange
from deltaid.effects.missing_friction import MissingFriction
from deltaid.effects.mounting import Mounting
from deltaid.effects.place import PlaceDependence
from deltaid.effects.point import Added, TracePoint, UnknownEffect
from deltaid.effects.presliding import Presliding, YieldingFriction
from deltaid.effects.ripple import PositionRipple
from deltaid.effects.saturation import Saturation
from deltaid.effects.windings import WindUp
from deltaid.effects.zero import Zero
from deltaid.model.corrections import FittedEffect

EFFECTS: tuple[Effect, ...] = (
    Delay(),
    Gain(),
    Saturation(),
    GainOverTime(),
    FrictionLaw(),
    YieldingFriction(),
    RubbingJoints(),
    Drift(),
    Zero(),
    PlaceDependence(),
    PositionRipple(),
    LoadChange(),
    MissingFriction(),
)

UNKNOWNS: tuple[UnknownEffect, ...] = (
    FrictionOverSpeed(),
    FrictionByDirection(),
    FrictionByLoad(),
    Drift(),
    Delay(),
    WindUp(),
    Gain(),
    Saturation(),
    GainOverTime(),
    Zeros(),
    GearRatios(),
    Tilt(),
    Lengths(),
    Mounting(),
    Structure(),
    UnlikeLimbs(),
)

ALONG_MOTION: tuple[type[AlongMotion], ...] = (
    RippleColumns,
    DriveSpring,
    Presliding,
    *FORCES,
    Cable,
    BallJointFriction,
)


def unknowns_at(point: TracePoint) -> tuple[UnknownEffect, ...]:
    """All effects of the contest; those along the motion have a prior of 1 in their units."""
    dynamics, every = point.dynamics, tuple(range(point.dof))
    spring = DriveSpring(dynamics, every, (1.0,) * point.dof)
    forces = platform_forces(dynamics, point.fastest_platform)
    along = (spring, *forces, *of_ball_joints(point))
    return (*UNKNOWNS, Presliding.along(point), *(Added(effect.name, effect) for effect in along))


def as_fitted(dynamics: Dynamics, record: FittedEffect) -> FittedTorques:
    """An effect of a model file, for the robot's dynamics.

    Raises:
        StopIteration: no effect has this name.
        ValueError, IndexError: the robot has no such drive, or the effect needs other numbers.
    """
    drives = tuple(dynamics.robot.drives.index(drive) for drive in record.drives)
    effect = next(effect for effect in ALONG_MOTION if effect.name == record.name)
    deviation = (1.0,) * len(record.values)
    addition = effect(dynamics, drives, deviation, record.orders, record.fastest)
    home, rest = dynamics.kinematics.home[None], np.zeros((1, dynamics.dof))
    with np.errstate(divide="ignore", invalid="ignore"):
        entries, (_, places) = addition.of_motion(home, rest, rest), addition.pattern
    if places.max() + 1 != len(record.values) or not np.all(np.isfinite(entries)):
        raise ValueError("numbers do not fit")
    return FittedTorques(addition, record.values)


def effect_of(cause: Cause) -> Effect:
    return next(effect for effect in EFFECTS if effect.kind == cause.kind)
