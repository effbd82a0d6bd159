"""Units and gears of positions."""

from collections.abc import Iterator

import numpy as np

from deltaid.check.wiring.candidate import SLIDING, TURNING
from deltaid.check.wiring.case import Case, stated, torques_of_motor, velocities_follow
from deltaid.check.wiring.cures import Values
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.mapping import Quantity

# More than this share of the torques left, a factor of positions is doubtful.
_SURE = 0.08


def position_verdicts(case: Case) -> Iterator[Verdict]:
    """Units and gears of positions."""
    scale = case.best.map.scale
    for factor in dict.fromkeys(abs(f) for f in scale):
        drives = [i for i, f in enumerate(scale) if abs(f) == factor]
        if factor != 1:
            yield _scaled(case, drives, factor)
    for i, unit in case.units.items():
        if abs(scale[i]) == 1:
            yield _scaled(case, [i], unit)


def _scaled(case: Case, drives: list[int], factor: float) -> Verdict:
    linear = case.linear(drives[0])
    name = (SLIDING if linear else TURNING).get(factor)
    values: Values = {}
    velocity: Values = {}
    follows = velocities_follow(case, drives)
    for i in drives:
        source = case.best.map.order[i]
        if name is not None:
            values[i] = case.entries.in_unit("position", source, factor)
            velocity[i] = case.entries.in_unit("velocity", source, factor) if follows else {}
        else:
            values[i] = case.entries.of_motor("position", source, factor)
            velocity[i] = case.entries.of_motor("velocity", source, factor) if follows else {}
    proposed: dict[Quantity, Values] = {"position": values, "velocity": velocity}
    whose = case.all_or(drives)
    seen = (
        f"positions of {whose} make sense only times {factor:.3g}: the loops then close, which "
        f"{case.fits}"
    )
    if name is not None:
        cause = f"positions of {whose} are in {name}"
        cure = f"declare the unit of the position columns: {name}"
        key = "angle-unit"
    else:
        ratio = 1 / factor
        gear = f"a gear of about {ratio:.3g}"
        if linear:
            gear = f"a lead of about {1e3 * 2 * np.pi * factor:.3g} mm per revolution"
        cause = f"positions of {whose} are those of the motor, behind {gear}"
        cure = "declare the gear (or lead) of the position columns, exactly"
        key = "gear"
        if torques_of_motor(case, factor):
            cause += ", and so are the torques"
            cure = "declare the gear (or lead) of position and torque columns, exactly"
            proposed["torque"] = {
                i: case.entries.of_motor("torque", case.best.order[i], ratio) for i in drives
            }
    return Verdict(
        key,
        Grade.WRONG if case.best.left < _SURE else Grade.DOUBTFUL,
        seen,
        case.whose(drives),
        cause,
        cure,
        case.entries.proposal(stated(proposed)),
        number=factor,
    )
