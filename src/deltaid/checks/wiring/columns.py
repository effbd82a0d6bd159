"""Verdicts on position and torque columns: units, gears, signs, order, scale."""

from collections.abc import Iterator

import numpy as np

from deltaid.checks.evidence import WRONG_SCALE, Values
from deltaid.checks.wiring.candidate import LITTLE, named_units
from deltaid.checks.wiring.explained import INERTIA, RemappedRecording, in_unit, overall
from deltaid.checks.wiring.residual import UNIT, Map
from deltaid.checks.wiring.search import SMALLEST
from deltaid.checks.wiring.velocity import rates
from deltaid.errors import plural
from deltaid.model.verdict import Grade, Verdict, listed
from deltaid.recording.mapped_columns import Quantity

# For hypotheses that explain a recording equally well.
_UNDECIDED = "the recording does not show which"
# Likeliest cause of positions that are whole numbers, and the cure.
COUNTS = (
    "counts of encoders, or parts of a degree: all their numbers are whole",
    "declare the unit of the position columns, such as a turn over its counts, and the gear: "
    "{unit: 360/65536 deg, gear: 33}",
)
# Thousandths of the torque unit, for rotary and linear drives.
_MILLI = "mN m", "mN"


def _follow(log: RemappedRecording, drives: list[int]) -> tuple[Quantity, ...]:
    """Quantities to correct: positions, and velocities if these are their derivatives as mapped."""
    as_mapped = rates(log.motion, Map.identity(len(log.names)))
    unscaled = all(0.8 < rate.scale < 1.25 for rate in as_mapped if rate.drive in drives)
    return ("position", "velocity") if as_mapped and unscaled else ("position",)


def column_verdicts(log: RemappedRecording) -> tuple[Verdict, ...]:
    """Verdicts on positions and torques; later ones depend on earlier ones. None if these are
    unrelated: what explains no torque shows no unit."""
    if log.unrelated:
        return ()
    return (*_positions(log), *_signs(log), *_order(log), *_torques(log))


def _positions(log: RemappedRecording) -> Iterator[Verdict]:
    scale = np.abs(log.best.map.scale).tolist()
    for factor in dict.fromkeys(factor for factor in scale if factor != 1):
        yield _scaled(log, [i for i, f in enumerate(scale) if f == factor], factor)
    for i, unit in log.units.items():
        if scale[i] == 1:
            yield _scaled(log, [i], unit)


def _scaled(log: RemappedRecording, drives: list[int], factor: float) -> Verdict:
    """Positions that must be multiplied by a factor."""
    record, best, whose = log.evidence, log.best, log.all_or(drives)
    reason = (
        "inertia and friction then agree best with the prior"
        if all(drive in log.units for drive in drives)
        else "the loops then close"
    )
    name, ratio = named_units(record.robot, drives[0]).get(factor), 1 / factor
    change = record.of_motor if name is None else record.in_unit
    changes: dict[Quantity, Values] = {
        quantity: {i: change(quantity, best.map.order[i], factor) for i in drives}
        for quantity in _follow(log, drives)
    }
    cause, cure = f"in {name}", f"declare the unit of the position columns: {name}"
    if name is None and record.are_counts:
        (cause, cure), changes = COUNTS, {}
    elif name is None:
        gear = f"a gear of about {ratio:.3g}"
        if log.linear(drives[0]):
            gear = f"a lead of about {1e3 * 2 * np.pi * factor:.3g} mm per revolution"
        cause = f"those of the motor, behind {gear}"
        cure = "declare the gear (or lead) of the position columns, exactly"
        if log.of_motors(factor):
            cause += ", and so are the torques"
            cure = "declare the gear (or lead) of position and torque columns, exactly"
            changes["torque"] = {i: change("torque", best.order[i], ratio) for i in drives}
    return Verdict(
        "gear" if name is None else "angle-unit",
        Grade.WRONG if best.unexplained < LITTLE else Grade.DOUBTFUL,
        f"positions of {whose} make sense only times {factor:.3g}: {reason}, which {log.fits}",
        log.whose(drives),
        f"positions of {whose} are {cause}",
        cure,
        record.proposal(changes) if best.unexplained < LITTLE else (),
        number=factor,
    )


def _signs(log: RemappedRecording) -> Iterator[Verdict]:
    best, n = log.best, len(log.names)
    angles, torques = (np.flatnonzero(np.less(x, 0)) for x in (best.map.scale, best.gains))
    if n == 1 and not angles.size and log.ratios[0][INERTIA] < -1 / WRONG_SCALE < best.gains[0]:
        # No loop determines a lone drive's sign, and gravity may be even: negative inertia does.
        yield _angle_sign(log, 0)
    if len(torques) == n > 1 and not angles.size:
        yield _torque_sign(log, torques.tolist())
        return
    for i in np.union1d(angles, torques).tolist():
        signs = dict.fromkeys((c.map.scale[i] < 0, bool(c.gains[i] < 0)) for c in log.rivals)
        for angle, torque in signs:
            if angle:
                yield _angle_sign(log, i, both=torque, sure=len(signs) == 1)
            elif torque:
                yield _torque_sign(log, [i], sure=len(signs) == 1)


def _angle_sign(
    log: RemappedRecording, i: int, *, both: bool = False, sure: bool = True
) -> Verdict:
    """`both`: the torque's sign is wrong too; `sure`: no other hypothesis explains it as well."""
    name, turned = log.names[i], log.evidence.turned
    columns = _follow(log, [i])
    changes: dict[Quantity, Values] = {q: {i: turned(q, log.best.map.order[i])} for q in columns}
    cause, turn = f"the angle of {name} counts the other way", "position column"
    if both:
        cause = f"{name} counts the other way, in angle and torque"
        turn = "position and torque column"
        changes["torque"] = {i: turned("torque", i)}
    return Verdict(
        "angle-sign",
        Grade.WRONG if sure else Grade.DOUBTFUL,
        f"only with the other sign of {name} its motion goes with the loops and torques; that "
        f"{log.fits}",
        name,
        cause if sure else f"{cause}, or another sign is wrong; {_UNDECIDED}",
        f"turn the sign of its {turn}",
        log.evidence.proposal(changes) if sure else (),
    )


def _torque_sign(log: RemappedRecording, drives: list[int], *, sure: bool = True) -> Verdict:
    order, whose, record = log.best.order, log.all_or(drives), log.evidence
    against = float(-log.best.correlations[drives].min())
    changes: Values = {i: record.turned("torque", order[i]) for i in drives} if sure else {}
    instead = "" if sure else f", or the angle does; {_UNDECIDED}"
    return Verdict(
        "torque-sign",
        Grade.WRONG if sure else Grade.DOUBTFUL,
        f"the torque of {whose} works against the motion: its correlation with the prior's is "
        f"{against:.2g}; with the other sign the model {log.fits}",
        log.whose(drives),
        f"the torque of {whose} counts the other way{instead}",
        f"turn the sign of the torque {plural('column', len(drives))}",
        record.proposal({"torque": changes}),
        number=against,
    )


def _order(log: RemappedRecording) -> Iterator[Verdict]:
    n, torque, position = len(log.names), log.best.order, log.best.map.order
    in_order = tuple(range(n))
    moved = [i for i in range(n) if torque[i] != i or position[i] != i]
    if not moved:
        return
    order: dict[Quantity, tuple[int, ...]] = dict.fromkeys(_follow(log, moved), position)
    order["torque"] = torque
    changes: dict[Quantity, Values] = {
        quantity: {i: log.evidence.taken_from(j, quantity, i) for i, j in enumerate(columns)}
        for quantity, columns in order.items()
    }
    given, quantities, instead = position, "positions", "torques"
    if position == in_order:
        given, quantities, instead = torque, "torques", "positions"
    elif torque == position:
        quantities = "positions and torques together"
    columns = listed([f"{log.names[i]} from the columns of {log.names[given[i]]}" for i in moved])
    # Identical limbs are interchangeable: the recording determines which torque belongs to which
    # position, and columns that moved together keep their names.
    others = {(other.map.order, other.order) for other in log.rivals}
    sure = all(positions == torques for positions, torques in others) or len(others) == 1
    doubt = "" if sure else f", or the {instead} are; {_UNDECIDED}"
    yield Verdict(
        "drive-order",
        Grade.WRONG,
        f"torques and motion belong together only in another order, which {log.fits}",
        log.whose(moved),
        f"the {quantities} are in another order than the drives: {columns}{doubt}",
        "map the columns in the order of the drives",
        log.evidence.proposal(changes) if sure else (),
    )


def _torques(log: RemappedRecording) -> Iterator[Verdict]:
    best, ratios = log.best, log.ratios.copy()
    for i in np.flatnonzero(np.abs(best.gains) != 1).tolist():
        yield _one_torque(log, i, float(abs(best.gains[i])))
    for i, unit in log.units.items():
        ratios[i] = in_unit(ratios[i], unit)
    size = overall(ratios[~best.loose] if not best.loose.all() else ratios)
    if best.map.scaled and log.of_motors(abs(best.map.scale[best.map.scaled[0]])):
        return
    common = max(size, 1 / size) > UNIT
    if common:
        yield _all_torques(log, size)
    for i in log.untied:
        ratio = overall(log.ratios[i])
        if i not in log.units and not common and max(ratio, 1 / ratio) > WRONG_SCALE:
            yield _one_torque(log, i, 1 / ratio, rough=True)


def _one_torque(log: RemappedRecording, i: int, gain: float, *, rough: bool = False) -> Verdict:
    """A drive whose torques must be multiplied by `gain` relative to the others."""
    source, record, whose = (
        log.best.order[i],
        log.evidence,
        f"the torque of {log.names[i]}",
    )
    beside = "the prior says" if rough else "those of the other drives ask for"
    change: dict[str, object] = {}
    if gain > 1:
        cause = f"that of the motor, behind a gear of about {gain:.3g}"
        cure = "declare the gear (or lead) of its torque column, exactly"
        change = {} if rough else record.of_motor("torque", source, gain)
    else:
        unit, cure = _MILLI[log.linear(i)], "declare the unit of its torque column"
        if 0.8 < 1e3 * gain < 1.25:
            change = record.in_unit("torque", source, 1e-3)
        other = f"another unit, such as {unit} or per mille of a rated torque"
        cause = f"in {unit if change else other}"
    return Verdict(
        "gear" if gain > 1 else "torque-unit",
        Grade.WRONG,
        f"{whose} is {1 / gain:.3g} times what {beside}",
        log.names[i],
        f"{whose} is {cause}",
        cure,
        record.proposal({"torque": {i: change}}),
        max(gain, 1 / gain),
    )


def _all_torques(log: RemappedRecording, size: float) -> Verdict:
    """Torques of all drives that are `size` times those of the prior."""
    doubtful, linear, changes = max(size, 1 / size) <= WRONG_SCALE, log.linear(0), Values()
    if size < SMALLEST:
        cause = "the columns hold another signal, or torques in a far larger unit"
        cure = "check by name which signals they hold, and declare their unit"
    elif size < 1:
        gear = "a gear or spindle" if linear else f"a gear of about {1 / size:.2g}"
        cause = f"torques are those of the motors, behind {gear}"
        cause += ", or currents without their torque_constant"
        if doubtful:
            cause = f"a gear is not declared, or the prior is {1 / size:.2g} times too heavy"
        cure = "declare gear (or lead) and torque_constant of the torque columns"
    elif 300 < size < 3000:
        cause = f"torques are in {_MILLI[linear]}, or in per mille of a rated torque of about 1"
        order = enumerate(log.best.order)
        changes = {i: log.evidence.in_unit("torque", column, 1e-3) for i, column in order}
        cure = "declare the unit of the torque columns"
    else:
        unit = "N" if linear else "N m"
        cause = f"torques are in per mille of a rated torque of about {1000 / size:.2g} {unit}"
        if 70 < size < 300:
            cause += ", in per cent of one ten times smaller, or in N cm"
        if doubtful:
            cause += f", or the prior is {size:.2g} times too light"
        cure = (
            "declare the unit of the torque columns, the rated torque in it, such as "
            "0.0235 N*m for per mille of 23.5 N m"
        )
    return Verdict(
        "gear" if SMALLEST <= size < 1 else "torque-unit",
        Grade.DOUBTFUL if doubtful else Grade.WRONG,
        f"torques are {size:.3g} times those that the prior leads to, in all drives",
        "",
        cause,
        cure,
        log.evidence.proposal({"torque": changes}),
        number=size,
    )
