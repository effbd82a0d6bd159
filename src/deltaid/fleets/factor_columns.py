"""Columns of a recording that allow any later fit of its robot.

- Rigid bodies, rotors, springs: the representatives of the base parameters of a generic motion.
  All their other columns are combinations of these by the mechanism alone.
- Friction, by splines over speed: sign(v) φ(|v|) in a joint, φ a sum of terms. A cubic
  spline through knots v_k on the axis of speed follows every usual φ, φ(|v|) ≈ Σ_k φ(v_k) s_k(|v|),
  with cardinal splines s_k that are one at their knot and zero at all others. Columns of any law
  and its constants are combinations of sign(v) s_k(|v|); viscous and Coulomb friction are exact. A
  drive has the columns 1 and |v| as well, for one-way friction, and sign(q̇) |x|, x the load of
  its gear.
- Loads while they are held.
- Nuisance columns of this recording: residual lag of each drive, friction that changes along it.

A column of a fit is a combination of gathered ones, Y = G T: of a rigid body by the mechanism alone
(base parameters of a generic motion), of a friction term by its values at the knots of a spline.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.effects.joint import FrictionJoint, joints_of, of_load, one_way, one_way_speed
from deltaid.estimation.additions import Addition, Extended, Own, Values, extended
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import active_columns
from deltaid.identification.friction_constants import LawConstants
from deltaid.identification.generic_motion import random_motion_base
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import PriorParameter

# Reference speeds of joints whose limits the description does not give [rad/s, m/s].
_TURNING, _SLIDING = 20.0, 5.0
# Knots as shares of a joint's reference speed: dense where Stribeck's terms bend. Beyond the last
# one splines continue as straight lines.
KNOTS = (0.0, 0.0025, 0.006, 0.012, 0.024, 0.045, 0.08, 0.14, 0.24, 0.4, 0.65, 1.0)
_CARDINAL = CubicSpline(KNOTS, np.eye(len(KNOTS)), bc_type="natural")
# Speed [rad/s, m/s] at which friction at rest is evaluated, on one side of the step.
_CREEP = np.finfo(float).eps


def splines(v: Float[np.ndarray, " samples"], top: float) -> Float[np.ndarray, "knots samples"]:
    """s_k(v) at speeds v ≥ 0 for a reference speed, with Σ s_k(v) = 1 and Σ v_k s_k(v) = v."""
    x = v / top
    return _CARDINAL(np.minimum(x, 1.0)).T + np.outer(_CARDINAL(1.0, 1), np.maximum(x - 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class SpeedColumns(Addition):
    """Columns of one joint's friction over speed; `top` is its reference speed [rad/s, m/s]."""

    name: str
    top: float

    @cached_property
    def joint(self) -> FrictionJoint:
        """The joint and its entries in the regressor."""
        return next(joint for joint in joints_of(self.dynamics) if joint.name == self.name)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """One constant for each spline; for a drive, also those of one-way friction."""
        symbols = [f"speed{k}" for k in range(len(KNOTS))]
        symbols += [] if self.joint.drive is None else ["one_way", "one_way_speed"]
        return _constants(self.name, symbols, self.dynamics.robot.units(self.name).force)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, count = self.joint.drives, len(self.parameters)
        return np.tile(rows, count), np.repeat(np.arange(count), len(rows))

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        """sign(v) s_k(|v|) ∂v/∂q̇, then 1 and |v|."""
        C, v = own[self.joint.coulomb], self.joint.speed(own)
        columns = [C * s for s in splines(v, self.top)]
        if self.joint.drive is not None:
            columns += [one_way(v, C, v), one_way_speed(v, C, v)]
        return np.vstack(columns)

    def following(self, h: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, " columns"]:
        """The combination of columns for a law h(v), v with its sign."""
        knots = self.top * np.array(KNOTS)
        v = np.maximum(knots, _CREEP)
        odd, even = 0.5 * (h(v) - h(-v)), 0.5 * (h(v) + h(-v))
        if self.joint.drive is None:
            return odd
        return np.array([*odd, even[0], (even[-1] - even[0]) / knots[-1]])


@dataclass(frozen=True, eq=False)
class CarriedColumns(Addition):
    """One column per drive, sign(q̇) |x|, with x from parameters p of the robot and its load."""

    p: Float[np.ndarray, " parameters"]

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        drives = self.dynamics.robot.drives
        return tuple(entry for drive in drives for entry in _constants(drive, ["carried"], "1"))

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives = np.arange(self.dynamics.dof)
        return drives, drives

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        x = self.dynamics.carried(w.z, w.qd, w.qdd, self.p) + w.carried
        return of_load(w.qd, np.sign(w.qd), x).T


def _constants(joint: str, symbols: list[str], unit: str) -> tuple[PriorParameter, ...]:
    return tuple(
        PriorParameter("constant", joint, symbol, unit, -np.inf, np.inf, 0.0, 1.0)
        for symbol in symbols
    )


def plain(robot: RobotDescription) -> RobotDescription:
    """The robot with viscous and Coulomb friction only."""
    return robot.changed(
        friction={joint: law.plain for joint, law in robot.friction.items()},
        measured=(),
        sensors={},
    )


_generic_base = lru_cache(maxsize=8)(random_motion_base)


def _reference_speed(robot: RobotDescription, joint: str) -> float:
    """Speed up to which a joint's friction has knots [rad/s or m/s]."""
    usual = _SLIDING if robot.units(joint).coordinate == "m" else _TURNING
    return robot.limits_of(joint).top_speed or usual


@dataclass(frozen=True, eq=False)
class GatheredColumns:
    """The columns of one robot, with additional ones."""

    dynamics: Dynamics  # of the robot with plain friction
    additions: tuple[Addition, ...]  # speed columns, then carried load, then all others

    @classmethod
    def for_robot(
        cls,
        robot: RobotDescription,
        p: Float[np.ndarray, " parameters"],
        others: Sequence[Addition] = (),
    ) -> "GatheredColumns":
        """Columns of a robot; p are parameters of the plain robot, for the gears' load."""
        dynamics = compiled(plain(robot))
        speeds = (
            SpeedColumns(dynamics, joint, _reference_speed(dynamics.robot, joint))
            for joint in dynamics.robot.friction_joints
        )
        return cls(
            dynamics,
            (
                *speeds,
                CarriedColumns(dynamics, p),
                *(addition.on(dynamics) for addition in others),
            ),
        )

    @cached_property
    def regressor(self) -> Extended:
        """The plain robot's columns, then the additions."""
        return extended(self.dynamics, self.additions)

    @property
    def base(self) -> BaseParameters:
        """Base parameters of the plain robot for a generic motion."""
        return _generic_base(self.dynamics)

    @cached_property
    def stored(self) -> Int[np.ndarray, " stored"]:
        """Indices of the regressor's columns that go into a file."""
        count = len(self.dynamics.layout.names)
        friction = range(count)[self.dynamics.layout.friction]
        rigid = {group.representative for group in self.base.groups} - {*friction}
        return np.intersect1d(
            [*rigid, *range(count, len(self.names))], active_columns(self.regressor)
        )

    @cached_property
    def of_drives(self) -> tuple[Int[np.ndarray, " _"], ...]:
        """Indices of each drive's columns among the columns of a file."""
        drives, entries = self.regressor.regressor_pattern
        return tuple(
            np.flatnonzero(np.isin(self.stored, entries[drives == i]))
            for i in range(self.dynamics.dof)
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        added = (parameter.name for addition in self.additions for parameter in addition.parameters)
        return (*self.dynamics.layout.names, *added)

    @cached_property
    def place(self) -> dict[str, int]:
        """Index of each name among the columns of a file."""
        return {self.names[column]: k for k, column in enumerate(self.stored)}


def map_to(
    columns: GatheredColumns, dynamics: Dynamics, additions: Sequence[Addition] = ()
) -> Float[np.ndarray, "kept columns"]:
    """T for a robot of the same mechanism with any friction law, and for additions: gathered loads,
    and constants of the robot's laws."""
    plain_names = columns.dynamics.layout.names
    shares: dict[str, dict[str, float]] = {}
    for group in columns.base.groups:
        representative = plain_names[group.representative]
        for member, share in {group.representative: 1.0, **group.members}.items():
            shares.setdefault(plain_names[member], {})[representative] = share
    shares |= {
        term.name: _friction(columns, term, term.values) for term in dynamics.robot.friction_terms
    }
    every = [shares.get(name, {}) for name in dynamics.layout.names]
    for extra in additions:
        if isinstance(extra, LawConstants):
            every += [
                _friction(columns, term, partial(_slope, term, constant))
                for term, constant in extra.constants
            ]
        else:
            every += [{parameter.name: 1.0} for parameter in extra.parameters]
    # Names without a gathered column have no effect on torques.
    return np.array(
        [[combination.get(name, 0.0) for combination in every] for name in columns.place]
    )


def _friction(
    columns: GatheredColumns, term: FrictionTerm, h: Callable[[np.ndarray], np.ndarray]
) -> dict[str, float]:
    """Friction h(v) in a term's joint, or its share of the load, in gathered columns."""
    if term.of_load:
        return {f"carried.{term.joint}": 1.0}
    speeds = (addition for addition in columns.additions if isinstance(addition, SpeedColumns))
    group = next(group for group in speeds if group.name == term.joint)
    names = (parameter.name for parameter in group.parameters)
    return dict(zip(names, group.following(h).tolist(), strict=True))


def _slope(term: FrictionTerm, constant: str, v: np.ndarray) -> np.ndarray:
    return term.size * term.slopes(v)[constant]
