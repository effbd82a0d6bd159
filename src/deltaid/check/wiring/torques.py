"""The scale of torques: gears, units and currents, of one drive or of all."""

from collections.abc import Iterator

from deltaid.check.wiring.case import (
    DOUBTFUL_SCALE,
    WRONG_SCALE,
    Case,
    stated,
    torques_of_motor,
)
from deltaid.check.wiring.cures import Values
from deltaid.check.wiring.scale import INERTIA, VISCOUS, overall
from deltaid.model.verdict import Grade, Verdict


def torque_verdicts(case: Case) -> Iterator[Verdict]:
    best = case.best
    far = [i for i, gain in enumerate(best.gains) if abs(gain) != 1]
    for i in far:
        yield _one_torque(case, i, float(abs(best.gains[i])))
    scaled = [abs(f) for f in best.map.scale if abs(f) != 1]
    found = case.ratios.copy()
    for i, unit in case.units.items():
        found[i, [INERTIA, VISCOUS]] /= unit
    tied = [i for i in range(len(case.names)) if not best.loose[i]] or list(range(len(case.names)))
    size = overall(found[tied])
    if scaled and torques_of_motor(case, scaled[0]):
        return
    common = max(size, 1 / size) > DOUBTFUL_SCALE
    if common:
        yield _all_torques(case, size)
    for i in case.untied:
        own = overall(case.ratios[i])
        if i not in case.units and not common and max(own, 1 / own) > WRONG_SCALE:
            yield _one_torque(case, i, 1 / own, rough=True)


def _one_torque(case: Case, i: int, gain: float, *, rough: bool = False) -> Verdict:
    """A drive whose numbers must be multiplied by `gain`, beside those of the others."""
    name, source = case.names[i], case.best.order[i]
    entries = case.entries
    beside = "the prior says" if rough else "those of the other drives ask for"
    seen = f"the torque of {name} is {1 / gain:.3g} times what {beside}"
    if gain > 1:
        return Verdict(
            "gear",
            Grade.WRONG,
            seen,
            name,
            f"the torque of {name} is that of the motor, behind a gear of about {gain:.3g}",
            "declare the gear (or lead) of its torque column, exactly",
            () if rough else entries.proposal(
                {"torque": {i: entries.of_motor("torque", source, gain)}}
            ),
            number=gain,
        )  # fmt: skip
    thousandth = 0.8 < 1e3 * gain < 1.25
    milli = entries.in_unit("torque", source, 1e-3) if thousandth else {}
    return Verdict(
        "torque-unit",
        Grade.WRONG,
        seen,
        name,
        f"the torque of {name} is in {_milli(case, i)}" if milli else
        f"the torque of {name} is in another unit, such as {_milli(case, i)} or per mille of a "
        "rated torque",
        "declare the unit of its torque column",
        entries.proposal({"torque": {i: milli}}) if milli else (),
        number=1 / gain,
    )  # fmt: skip


def _milli(case: Case, i: int) -> str:
    return "mN" if case.linear(i) else "mN m"


def _all_torques(case: Case, size: float) -> Verdict:
    entries, drives = case.entries, range(len(case.names))
    grade = Grade.WRONG if max(size, 1 / size) > WRONG_SCALE else Grade.DOUBTFUL
    seen = f"torques are {size:.3g} times those that the prior leads to, in all drives alike"
    values: Values = {}
    if size < 1:
        cause = "torques are those of the motors, behind a gear"
        cause += f" of about {1 / size:.2g}" if not case.linear(0) else " or spindle"
        cause += ", or currents without their torque_constant"
        if grade is Grade.DOUBTFUL:
            cause = f"a gear is not declared, or the prior is {1 / size:.2g} times too heavy"
        return Verdict("gear", grade, seen, "", cause,
                       "declare gear (or lead) and torque_constant of the torque columns",
                       number=size)  # fmt: skip
    if 300 < size < 3000:
        cause = f"torques are in {_milli(case, 0)}, or in per mille of a rated torque of about 1"
        values = {i: entries.in_unit("torque", case.best.order[i], 1e-3) for i in drives}
        cure = "declare the unit of the torque columns"
    else:
        rated = 1000 / size
        unit = "N" if case.linear(0) else "N m"
        cause = f"torques are in per mille of a rated torque of about {rated:.2g} {unit}"
        if 70 < size < 300:
            cause += ", in per cent of one ten times smaller, or in N cm"
        cure = (
            "declare the unit of the torque columns, the rated torque in it, such as "
            "0.0235 N*m for per mille of 23.5 N m"
        )
        if grade is Grade.DOUBTFUL:
            cause += f", or the prior is {size:.2g} times too light"
    return Verdict("torque-unit", grade, seen, "", cause, cure,
                   entries.proposal(stated({"torque": values})),
                   number=size)  # fmt: skip
