"""Joints with friction, and columns of torques over their speed and the torque of their gears."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.traces import Trace
from deltaid.recording.windows import SampleBlock
from deltaid.robot.friction_terms import FrictionTerm

Speeds = Float[np.ndarray, " *shape"]


def _near(knee: float) -> Callable[[Speeds], Speeds]:
    return lambda x: 1.0 / (1.0 + (x / knee) ** 2)


_NEAR, _SQUARE, _FLAT = (
    "more friction at low speed",
    "friction that grows with the square of speed",
    "friction that flattens with speed",
)
# Friction beside Coulomb's and viscous: functions of the speed as a share of the joint's largest.
# Their sum fits any usual law, Stribeck's to 7 % of its size.
SHAPES: tuple[tuple[Callable[[Speeds], Speeds], str], ...] = (
    *((_near(knee), _NEAR) for knee in (0.03, 0.06, 0.12, 0.24)),
    (np.square, _SQUARE),
    (np.sqrt, _FLAT),
)

# Name of the effect of friction by direction: for each drive a constant and a share of its speed.
BY_DIRECTION = "friction-direction"
# Usual size of a constant of friction by direction, as a share of Coulomb's (standard deviation).
ONE_WAY = 0.1
# Entries of a joint's column by |v|, entries of its Coulomb friction, and the torque of its gear.
Shape = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class FrictionJoint:
    """A joint with friction."""

    name: str
    drive: int | None  # its number; None for a passive joint
    # viscous, coulomb: numbers of its entries in the regressor
    viscous: np.ndarray
    coulomb: np.ndarray
    drives: np.ndarray  # the drive in whose row each Coulomb entry is
    fastest: float = 0.0  # its largest speed [rad/s or m/s]
    # inertia that counts as carried by its gear, beside that by the parameters [kg m² or kg]
    moved: float = 0.0

    def speed(self, entries: np.ndarray) -> np.ndarray:
        """|v| by its entries of the regressor, v ∂v/∂q̇ and sign(v) ∂v/∂q̇."""
        viscous, coulomb = np.abs(entries[self.viscous]), np.abs(entries[self.coulomb])
        return viscous.max(axis=0) / np.maximum(coulomb.max(axis=0), 1e-300)

    def load(self, carried: np.ndarray, w: SampleBlock) -> np.ndarray:
        """The torque that its gear carries; zero for a passive joint."""
        if self.drive is None:
            return np.zeros(len(carried))
        return carried[:, self.drive] + self.moved * w.qdd[:, self.drive]


def joints_of(dynamics: Dynamics) -> tuple[FrictionJoint, ...]:
    """Joints with friction, without their largest speeds."""
    rows, columns = dynamics.regressor_pattern
    names, robot = np.array(dynamics.layout.names)[columns], dynamics.robot
    joints = list[FrictionJoint]()
    for joint in robot.friction_joints:
        viscous, coulomb = (
            np.flatnonzero(names == f"{term}.{joint}") for term in ("viscous", "coulomb")
        )
        drive = robot.drives.index(joint) if joint in robot.drives else None
        joints.append(FrictionJoint(joint, drive, viscous, coulomb, rows[coulomb]))
    return tuple(joints)


def joint_columns(
    trace: Trace, p: Parameters, shapes: Sequence[tuple[FrictionJoint, Shape]]
) -> ColumnsOfDrives:
    """One filtered column for each shape of a joint, with the torques of gears by p."""
    none = np.zeros(0, dtype=int)
    drives = [none, *(joint.drives for joint, _ in shapes)]
    columns = [none, *(np.full(len(places), k) for k, places in enumerate(drives[1:]))]

    def values(w: SampleBlock) -> np.ndarray:
        carried, entries = trace.carried(w, p), trace.entries(w)
        speeds = {joint.name: joint.speed(entries) for joint, _ in shapes}
        parts = [
            make(speeds[joint.name], entries[joint.coulomb], joint.load(carried, w))
            for joint, make in shapes
        ]
        return np.concatenate([entries[:0], *parts])

    return trace.columns(values, (np.concatenate(drives), np.concatenate(columns)), len(shapes))


def one_way(_v: np.ndarray, C: np.ndarray, _load: np.ndarray) -> np.ndarray:
    return np.ones_like(C)


def one_way_speed(v: np.ndarray, C: np.ndarray, _load: np.ndarray) -> np.ndarray:
    return np.broadcast_to(v, C.shape)


def of_load(_v: np.ndarray, C: np.ndarray, load: np.ndarray) -> np.ndarray:
    return C * np.abs(load)


def over_speed(joint: FrictionJoint, shape: Callable[[Speeds], Speeds]) -> Shape:
    """Coulomb's entries times a function of the speed as a share of the joint's largest."""
    return lambda v, C, load: C * shape(v / joint.fastest)


def of_term(term: FrictionTerm) -> Shape:
    """A friction term: its odd part over speed times Coulomb's entries, its even part alone."""

    def shape(v: np.ndarray, C: np.ndarray, load: np.ndarray) -> np.ndarray:
        forth, back = term.h(v, 1.0, load), term.h(-v, -1.0, load)
        return C * (0.5 * (forth - back)) + 0.5 * (forth + back)

    return shape


def of_slope(term: FrictionTerm, constant: str) -> Shape:
    """The derivative of a friction term by the logarithm of one of its constants."""
    return lambda v, C, load: C * term.slopes(v)[constant]
