"""By how much a robot's lengths exceed those described, as symbols of a graph.

Torques and drive coordinates as functions of these are what a tolerance of a length goes through.
Only distances between joints count: a drive that stands further out does the same to all motion and
torques as a joint of the platform that stands further in.
"""

from dataclasses import dataclass, replace

import casadi as ca

from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, Par4Platform


@dataclass(frozen=True)
class LimbGrowth:
    """Of one limb [m].

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
    """Of all lengths [m].

    Attributes:
        limbs: one limb after the other.
        half: of half the distance of the platform's parts, where that is given.
        telescope: of the height of the base joint of a telescope bar.
    """

    limbs: tuple[LimbGrowth, ...]
    half: ca.SX
    telescope: ca.SX

    @classmethod
    def named(cls, limbs: int, mounted: bool = False) -> "LengthGrowth":
        """New symbols for so many limbs; with those of how limbs are mounted, or without."""
        each = [ca.SX.sym(f"grown{i + 1}", 3) for i in range(limbs)]
        half, telescope = ca.SX.sym("half"), ca.SX.sym("telescope")
        own = [LimbGrowth(x[0], x[1], x[2]) for x in each]
        if mounted:
            more = [ca.SX.sym(f"mounted{i + 1}", 5) for i in range(limbs)]
            own = [replace(x, place=m[:2], turn=m[2:]) for x, m in zip(own, more, strict=True)]
        return cls(tuple(own), half, telescope)

    @property
    def symbols(self) -> ca.SX:
        """All of them, limb by limb; behind them those of how limbs are mounted."""
        limbs = [x for limb in self.limbs for x in (limb.seat, limb.arm, limb.strut)]
        mounted = [
            x for limb in self.limbs for x in (limb.place, limb.turn) if isinstance(x, ca.SX)
        ]
        return ca.vertcat(*limbs, self.half, self.telescope, *mounted)


def mounting_symbols(limb: int, limbs: int) -> tuple[list[int], list[int]]:
    """Numbers of the symbols of where a limb (from 0, of so many) is mounted: those that move its
    joint of the platform along x, y, z of its frame, and those that turn this frame about them."""
    first = 3 * limbs + 2 + 5 * limb
    return [3 * limb, first, first + 1], [first + 2, first + 3, first + 4]


def grown_by(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Numbers of the symbols of each kind of length of a robot, one a limb or one for all."""
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
