"""Units, gears, signs, order and zeros of columns: what makes sense of a recording, and what not.

All hypotheses are tried on the same filtered stretch (`wiring_motion`): do the loops close, and how
much of the torques do least squares leave (`residual`, `search`)? What all drives may
have in common is judged by the prior (`wiring_scale`), zeros and gravity by their own columns
(`wiring_homing`), velocities by the derivatives of positions (`wiring_velocity`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.verdict import Grade, Verdict, worst
from deltaid.check.wiring.cures import Entries, Values
from deltaid.check.wiring.motion import Motion, motion
from deltaid.check.wiring.residual import Map
from deltaid.check.wiring.scale import INERTIA, VISCOUS, overall, ratios, unit_of
from deltaid.check.wiring.search import SLIDING, TURNING, Candidate, explained
from deltaid.check.wiring.velocities import velocity_verdicts
from deltaid.check.wiring.velocity import rates
from deltaid.check.wiring.zeros import zero_verdicts
from deltaid.check.words import listed, percent
from deltaid.recording.mapping import Quantity

# Torques so many times larger or smaller than the prior's are in another unit, or may be.
_WRONG_SCALE, _DOUBTFUL_SCALE = 4.0, 2.5
# Share of the torques that the right columns may leave.
_EXPLAINED = 0.5
# More than this share of the torques left, a factor of positions is doubtful.
_SURE = 0.08
# Correlation with the prior's torque of a drive whose own scale is worth asking for.
_GOES = 0.6
# Inertia of a lone drive below zero, as a share of the prior's, that tells its sign.
_MIRRORED = 0.3
# Correlation with the prior's torque below which a drive's is of another thing.
_SENSELESS = 0.2
# The part of it that hypotheses are looked for on, if it has so many samples.
_FEW, _FEWEST = 150, 40
_PART = {"longest": 6.0, "oversampled": 10.0}


@dataclass(frozen=True, eq=False)
class Case:
    """A recording under the columns that explain it best.

    Attributes:
        evidence: the recording.
        motion: the stretch that was looked at.
        good: the hypotheses that explain it equally well, the simplest first.
        entries: of the mapping.
    """

    evidence: Evidence
    motion: Motion
    good: tuple[Candidate, ...]
    entries: Entries

    @property
    def best(self) -> Candidate:
        """The simplest one."""
        return self.good[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the drives."""
        return self.evidence.robot.drives

    @property
    def along(self) -> float:
        """Least correlation of a moving drive's torque with that of the prior."""
        return float(self.best.along[~self.best.residual.still].min(initial=1.0))

    @cached_property
    def ratios(self) -> np.ndarray:
        """Torques over those of the prior, by drive and component."""
        return ratios(self.evidence.dynamics, self.motion, self.best)

    @property
    def untied(self) -> list[int]:
        """Drives that no limb ties to others: of a telescope if its torque goes with its motion."""
        last = len(self.names) - 1
        if last == 0:
            return [0]
        turns = self.evidence.robot.telescope is not None and bool(self.best.loose[last])
        return [last] if turns and self.best.along[last] > _GOES else []

    @cached_property
    def units(self) -> dict[int, float]:
        """Factors of units that only the prior tells, of drives that nothing ties to others."""
        found = {}
        for i in self.untied:
            units = SLIDING if self.linear(i) else TURNING
            unit = unit_of(self.ratios[i], self._beyond(i), units)
            found |= {i: unit} if unit != 1 else {}
        return found

    def _beyond(self, i: int) -> float:
        """How many times a drive goes beyond what is described of its speed or workspace."""
        robot, scale = self.evidence.robot, abs(self.best.map.scale[i])
        limits = robot.drive_limits.get(self.names[i])
        top = limits.top_speed if limits else None
        fast = scale * float(np.abs(self.motion.qd[:, i]).max()) / top if top else 0.0
        if len(self.names) > 1 or not self.linear(i):
            return fast
        _, half = robot.within(0.0)
        return max(fast, scale * float(np.ptp(self.motion.q[:, i]) / (2 * half[0])))

    @property
    def map(self) -> Map:
        """Of the positions, with these units."""
        scale = [f * self.units.get(i, 1.0) for i, f in enumerate(self.best.map.scale)]
        return replace(self.best.map, scale=tuple(scale))

    def linear(self, drive: int) -> bool:
        """Whether a drive slides."""
        return self.evidence.robot.is_linear(self.names[drive])

    def whose(self, drives: list[int]) -> str:
        """A subject: empty for all drives."""
        return "" if len(drives) == len(self.names) else ", ".join(self.names[i] for i in drives)

    def all_or(self, drives: list[int]) -> str:
        """The drives in a sentence."""
        if len(drives) == len(self.names):
            return "all drives" if len(drives) > 1 else self.names[0]
        return listed([self.names[i] for i in drives])

    @property
    def fits(self) -> str:
        """How well the best hypothesis explains the recording."""
        return f"leaves {percent(self.best.left)} of the torques unexplained"


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def checked_wiring(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on what the mapping says of positions, velocities and torques.

    None where the recording is too short to be filtered.
    """
    fine = motion(evidence.rows)
    if fine is None or len(fine.tau) < _FEWEST:
        return ()
    coarse = motion(evidence.rows, **_PART)
    if coarse is None or len(coarse.tau) < _FEW:
        coarse = fine
    good = explained(evidence.dynamics, fine, coarse)
    if not good:
        return (_out_of_reach(evidence),)
    case = Case(evidence, fine, good, Entries(evidence))
    found = [*_positions(case), *_signs(case), *_order(case), *_torques(case)]
    if case.best.closes and not found and _senseless(case):
        found.append(_senseless_verdict(case))
    if worst(found) is not Grade.WRONG:
        found += zero_verdicts(evidence, fine, case.best, case.entries)
    found += velocity_verdicts(evidence, fine, case.map, case.entries)
    if worst(found) in (Grade.GOOD, Grade.CANNOT_TELL) and not _senseless(case):
        found.insert(0, _good(case))
    return tuple(found)


def _good(case: Case) -> Verdict:
    size = overall(case.ratios)
    return Verdict(
        "drive-order",
        Grade.GOOD,
        f"the loops close, torques go with the motion of their drives ({case.along:.2g} "
        f"is the least correlation with those of the prior) and are {size:.2g} times those",
        number=case.along,
    )


def _senseless(case: Case) -> bool:
    return case.best.left > _EXPLAINED or case.along < _SENSELESS


def _senseless_verdict(case: Case) -> Verdict:
    i = int(np.argmin(np.where(case.best.residual.still, 1.0, case.best.along)))
    return Verdict(
        "drive-order",
        Grade.CANNOT_TELL,
        f"the torque of {case.names[i]} hardly goes with its motion: its correlation with the "
        f"prior's is {case.best.along[i]:.2g}, and no unit, sign or order explains the torques",
        subject=case.names[i],
        cause="the columns are of other signals, the drive hardly moves, or the prior is far off",
        cure="check by name which signals the torque columns hold",
        number=float(case.best.along[i]),
    )


def _out_of_reach(evidence: Evidence) -> Verdict:
    linear = [evidence.robot.is_linear(drive) for drive in evidence.robot.drives]
    units = "millimetres" if all(linear) else "degrees" if not any(linear) else "degrees or mm"
    return Verdict(
        "homing-or-tilt",
        Grade.WRONG,
        "the loops do not close along the recording, whatever is tried: neither numbers in "
        f"{units}, nor positions of the motor behind a gear, nor another sign of a drive, nor "
        "another order of the drives makes them close",
        cause="lengths of the description that are not the robot's, or zeros of several drives",
        cure="check the lengths, and where the drives have their zero (rotary: arm horizontal and "
        "outwards, positive = down)",
    )


# --- positions ---------------------------------------------------------------------------------


def _positions(case: Case) -> Iterator[Verdict]:
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
    follows = _follow(case, drives)
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
        if _torques_of_motor(case, factor):
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
        case.entries.proposal(_stated(proposed)),
        number=factor,
    )


def _stated(values: Mapping[Quantity, Values]) -> dict[Quantity, Values]:
    """Without drives of which nothing changes."""
    return {
        quantity: {i: entry for i, entry in drives.items() if entry}
        for quantity, drives in values.items()
    }


def _follow(case: Case, drives: list[int]) -> bool:
    """Whether velocities are derivatives of the positions as mapped, and so change with them."""
    plain = rates(case.motion, Map.identity(len(case.names)))
    return all(0.8 < one.scale < 1.25 for one in plain if one.drive in drives) and bool(plain)


def _torques_of_motor(case: Case, factor: float) -> bool:
    """Whether torques are too small by the gear that positions are too large by."""
    size = overall(case.ratios)
    return size < 1 / _DOUBTFUL_SCALE and 0.25 < size / factor < 4


# --- signs and order ---------------------------------------------------------------------------


def _signs(case: Case) -> Iterator[Verdict]:
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
    if entries.recorded("velocity") and _follow(case, [i]):
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


def _order(case: Case) -> Iterator[Verdict]:
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
    if entries.recorded("velocity") and position != plain and _follow(case, moved):
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
        entries.proposal(_stated(values)),
    )


# --- scale of torques --------------------------------------------------------------------------


def _torques(case: Case) -> Iterator[Verdict]:
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
    if scaled and _torques_of_motor(case, scaled[0]):
        return
    common = max(size, 1 / size) > _DOUBTFUL_SCALE
    if common:
        yield _all_torques(case, size)
    for i in case.untied:
        own = overall(case.ratios[i])
        if i not in case.units and not common and max(own, 1 / own) > _WRONG_SCALE:
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
    grade = Grade.WRONG if max(size, 1 / size) > _WRONG_SCALE else Grade.DOUBTFUL
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
                   entries.proposal(_stated({"torque": values})),
                   number=size)  # fmt: skip
