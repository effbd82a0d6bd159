"""Signs of angles and torques, and the order of the drives."""

from collections.abc import Iterator

from deltaid.check.wiring.case import Case, stated, velocities_follow
from deltaid.check.wiring.cures import Values
from deltaid.check.wiring.scale import INERTIA
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed
from deltaid.recording.mapping import Quantity

# Inertia of a lone drive below zero, as a share of the prior's, that tells its sign.
_MIRRORED = 0.3


def sign_verdicts(case: Case) -> Iterator[Verdict]:
    best = case.best
    turned = [i for i, f in enumerate(best.map.scale) if f < 0]
    if len(case.names) == 1 and not turned and case.ratios[0][INERTIA] < -_MIRRORED < best.gains[0]:
        # No loop shows the sign of a lone drive, and gravity may be even: inertia below zero does.
        yield from _angle_sign(case, 0, both=False)
    for i in turned:
        both = bool(best.gains[i] < 0)
        yield from _angle_sign(case, i, both=both)
    others = [i for i in range(len(case.names)) if best.gains[i] < 0 and i not in turned]
    if not others:
        return
    if len(others) == len(case.names) and len(others) > 1:
        yield _torque_sign(case, others)
        return
    for i in others:
        rival = _angle_instead(case, i)
        yield _torque_sign(case, [i], grade=Grade.DOUBTFUL if rival else Grade.WRONG)
        if rival:
            yield from _angle_sign(case, i, both=False, alone=False)


def _angle_instead(case: Case, i: int) -> bool:
    """Whether the drive's angle explains as much as its torque, turned around."""
    return any(
        one.map.scale[i] < 0 and one.gains[i] > 0 and one.changes == case.best.changes
        for one in case.good[1:]
    )


def _angle_sign(case: Case, i: int, *, both: bool, alone: bool = True) -> Iterator[Verdict]:
    name, entries = case.names[i], case.entries
    source = case.best.map.order[i]
    values: dict[Quantity, Values] = {"position": {i: entries.turned("position", source)}}
    if entries.recorded("velocity") and velocities_follow(case, [i]):
        values["velocity"] = {i: entries.turned("velocity", source)}
    cause = f"the angle of {name} counts the other way"
    if both:
        cause = f"{name} counts the other way, in angle and torque"
        values["torque"] = {i: entries.turned("torque", i)}
    elif not alone:
        cause += ", or its torque does; the motion does not tell which"
    yield Verdict(
        "angle-sign",
        Grade.WRONG if alone else Grade.DOUBTFUL,
        f"only with the other sign of {name} its motion goes with the loops and torques; that "
        f"{case.fits}",
        name,
        cause,
        f"turn the sign of its {'position' if not both else 'position and torque'} column",
        entries.proposal(values),
    )


def _torque_sign(case: Case, drives: list[int], grade: Grade = Grade.WRONG) -> Verdict:
    entries, order = case.entries, case.best.order
    whose = case.all_or(drives)
    cause = f"the torque of {whose} counts the other way"
    if grade is Grade.DOUBTFUL:
        cause += ", or the angle does; the motion does not tell which"
    with_prior = -case.best.along[drives]
    return Verdict(
        "torque-sign",
        grade,
        f"the torque of {whose} works against the motion: its correlation with the prior's is "
        f"{with_prior.max():.2g}; with the other sign the model {case.fits}",
        case.whose(drives),
        cause,
        "turn the sign of the torque column" + ("s" if len(drives) > 1 else ""),
        entries.proposal({"torque": {i: entries.turned("torque", order[i]) for i in drives}}),
        number=float(with_prior.max()),
    )


def order_verdicts(case: Case) -> Iterator[Verdict]:
    best, n = case.best, len(case.names)
    plain = tuple(range(n))
    if best.order == plain and best.map.order == plain:
        return
    entries, torque, position = case.entries, best.order, best.map.order
    moved = [i for i in range(n) if torque[i] != i or position[i] != i]
    values: dict[Quantity, Values] = {
        "position": {i: entries.moved("position", i, position[i]) for i in range(n)},
        "torque": {i: entries.moved("torque", i, torque[i]) for i in range(n)},
    }
    if entries.recorded("velocity") and position != plain and velocities_follow(case, moved):
        values["velocity"] = {i: entries.moved("velocity", i, position[i]) for i in range(n)}
    what = "torques" if position == plain else "positions"
    if torque == position:
        what = "positions and torques together"
    told = [position, torque][position == plain]
    sources = listed([f"{case.names[i]} from the columns of {case.names[told[i]]}" for i in moved])
    sure = not any(
        one.changes == best.changes and (one.map.order, one.order) != (position, torque)
        for one in case.good[1:]
    )
    cause = f"the {what} are in another order than the drives: {sources}"
    if not sure and position == plain:
        cause += " (or the positions are, the other way round; a symmetric robot does not tell)"
    yield Verdict(
        "drive-order",
        Grade.WRONG,
        f"torques and motion belong together only in another order, which {case.fits}",
        case.whose(moved),
        cause,
        "map the columns in the order of the drives",
        entries.proposal(stated(values)),
    )
