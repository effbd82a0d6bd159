"""Deviations of a robot's lengths from the described ones, as symbols of a graph.

Torques and drive coordinates as functions of these are what a tolerance of a length goes through.
Only distances between joints count: a drive that stands further out does the same to all motion and
torques as a joint of the platform that stands further in.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, Par4Platform


@dataclass(frozen=True)
class LimbGrowth:
    """Deviations of one limb [m].

    Attributes:
        seat: how much further out its joint of the platform stands, along x of the limb's frame.
        arm: of the upper arm; nothing that counts with a linear drive.
        strut: of the struts.
        place: how much further its joint of the platform stands along y and z of that frame.
        turn: by which that frame turns about its axes, through the base point [rad].
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
        symbols: seat, arm and strut of limb after limb, half of the platform, telescope; behind
            them those of how limbs are mounted, or none.
        count: of limbs.
    """

    symbols: ca.SX
    count: int

    @classmethod
    def named(cls, limbs: int, mounted: bool = False) -> "LengthGrowth":
        """New symbols for so many limbs, with or without those of their mounting."""
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
        """Deviation of half the distance of the platform's parts, where it is given."""
        return self.symbols[3 * self.count]

    @property
    def telescope(self) -> ca.SX:
        """Deviation of the height of the base joint of a telescope bar."""
        return self.symbols[3 * self.count + 1]


def mounting_symbols(limb: int, limbs: int) -> tuple[list[int], list[int]]:
    """Indices of the symbols of a limb's mounting (limb from 0, of so many): those that move its
    platform joint along x, y, z of its frame, and those that turn the frame about them."""
    first = 3 * limbs + 2 + 5 * limb
    return [3 * limb, first, first + 1], [first + 2, first + 3, first + 4]


def grown_by(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Indices of the symbols of each kind of length, one a limb or one for all."""
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
