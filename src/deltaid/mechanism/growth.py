"""Deviations of a robot's lengths from the description, as CasADi symbols.

Derivatives by these symbols turn tolerances of lengths into errors of torques and drive
coordinates. Only distances between joints matter: moving a drive outwards has the same effect as
moving its limb's platform joint inwards.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, Par4Platform


@dataclass(frozen=True)
class LimbGrowth:
    """Deviations of one limb [m].

    Attributes:
        seat: outward shift of its platform joint, along x of the limb's frame.
        arm: of the upper arm; without effect for a linear drive.
        strut: of the struts.
        place: shift of its platform joint along y and z of that frame; None without mounting.
        turn: rotation of that frame about its axes, at the base point [rad]; None without mounting.
    """

    seat: ca.SX
    arm: ca.SX
    strut: ca.SX
    place: ca.SX | None = None
    turn: ca.SX | None = None


@dataclass(frozen=True)
class LengthGrowth:
    """Deviations of all lengths [m].

    Attributes:
        symbols: seat, arm and strut of each limb, `half` of the platform, `telescope`; then those
            of the limbs' mounting, if any.
        count: number of limbs.
    """

    symbols: ca.SX
    count: int

    @classmethod
    def named(cls, limbs: int, mounted: bool = False) -> "LengthGrowth":
        """New symbols for a number of limbs, with or without those of their mounting."""
        return cls(ca.SX.sym("grown", 3 * limbs + 2 + (5 * limbs if mounted else 0)), limbs)

    def limb(self, i: int) -> LimbGrowth:
        """Deviations of one limb."""
        seat, arm, strut = (self.symbols[3 * i + k] for k in range(3))
        if self.symbols.numel() == 3 * self.count + 2:
            return LimbGrowth(seat, arm, strut)
        (_, *place), turn = mounting_symbols(i, self.count)
        return LimbGrowth(seat, arm, strut, self.symbols[place], self.symbols[turn])

    @property
    def half(self) -> ca.SX:
        """Deviation of half the distance between the platform's parts."""
        return self.symbols[3 * self.count]

    @property
    def telescope(self) -> ca.SX:
        """Deviation of the height of the base joint of a telescope bar."""
        return self.symbols[3 * self.count + 1]


def mounting_symbols(limb: int, limbs: int) -> tuple[list[int], list[int]]:
    """Indices of the symbols of a limb's mounting (limbs count from 0): shifts of its platform
    joint along x, y, z of the limb's frame, and rotations of the frame about them."""
    first = 3 * limbs + 2 + 5 * limb
    return [3 * limb, first, first + 1], [first + 2, first + 3, first + 4]


def grown_by(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Indices of the symbols of each kind of length: one for each limb, or one for all."""
    limbs = robot.limbs
    if limbs is None:
        return {}
    first = [3 * i for i in range(limbs.count)]
    numbers = {"base_radius": tuple(first), "platform_radius": tuple(first)}
    if limbs.drive == "rotary":
        numbers["upper_arm"] = tuple(k + 1 for k in first)
    numbers["strut"] = tuple(k + 2 for k in first)
    if isinstance(robot.platform, H4Platform | Par4Platform):
        numbers["platform"] = (3 * limbs.count,)
    if robot.telescope is not None:
        numbers["telescope"] = (3 * limbs.count + 1,)
    return numbers
