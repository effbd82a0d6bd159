"""Limbs that are mounted at other places of the base, or in other directions, than described."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.geometry import grown_torques
from deltaid.effects.point import Deviations, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.mechanism.growth import mounting_symbols
from deltaid.model.corrections import Correction
from deltaid.model.verdict import plus_minus
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.mounting import DRIVES, RAILS, leans, moved_and_turned


class Mounting(UnknownEffect):
    """Shifts of each limb's base point [m] and turns of its motor axis or rail [rad].

    Outwards, a base point moves as its joint at the platform moves inwards, which is a length.
    """

    name = corrected_as = "mounting"
    corrects = "robot"
    is_late = True
    deviation = 1e-3  # of a frame welded or printed: a millimetre, a milliradian

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        robot = point.dynamics.robot
        if not (numbers := numbers_of(robot)):
            return np.zeros((*point.model.shape, 0))
        slopes = replace(point.slopes, grown=grown_torques(robot, mounted=True))
        return point.weighted([
            slopes.of_growth(direction(kind, limb, robot.limb_geometry, slopes.grown.symbols))
            for limb, kind in numbers
        ])  # fmt: skip

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        names, each = DRIVES | RAILS, dict[int, list[str]]()
        for (limb, kind), value, wide in zip(
            numbers_of(robot), values.tolist(), half.tolist(), strict=True
        ):
            unit, name = names[kind]
            size = plus_minus(1e3 * value, 1e3 * wide)
            each.setdefault(limb, []).append(f"{name} {size} m{unit}")
        return tuple(
            Correction(
                kind="mounting",
                subject=f"limb {limb + 1}",
                text=f"it is mounted otherwise than described: {', '.join(sizes)}",
            )
            for limb, sizes in each.items()
        )


def direction(
    kind: str, limb: int, limbs: Sequence[LimbGeometry], symbols: int
) -> Float[np.ndarray, " growth"]:
    """Direction of a number of a limb's mounting in the space of all symbols; zero for others."""
    seat, turn = mounting_symbols(limb, len(limbs))
    growth = np.zeros(symbols)
    moved, growth[turn] = moved_and_turned(kind, limbs[limb])
    growth[seat] = -moved
    return growth


def numbers_of(robot: RobotDescription) -> tuple[tuple[int, str], ...]:
    """Limb and kind of each number of the limbs' mounting that a description can state."""
    limbs = robot.limbs
    if limbs is None:
        return ()
    rotary = limbs.drive == "rotary"
    kinds = [*DRIVES] if rotary else [*RAILS]
    if limbs.platform_radius is not None:
        kinds.remove("base_out" if rotary else "rail_out")
    if not rotary and not all(map(leans, limbs.geometry())):
        kinds.remove("lean_across")
    return tuple((limb, kind) for limb in range(limbs.count) for kind in kinds)


def by_limb(robot: RobotDescription, values: Sequence[float]) -> list[Mapping[str, float]]:
    """Values of `numbers_of` by kind, one dictionary a limb."""
    numbers = list(zip(numbers_of(robot), values, strict=True))
    limbs = range(len(robot.limb_geometry))
    return [{kind: x for (limb, kind), x in numbers if limb == i} for i in limbs]
