"""Check that recorded velocities are derivatives of recorded positions: scale, drive, lag.

Both pass the same low-pass: d = q̇ of the positions, v the column. Least squares of v = k (d − δ ḋ)
give the scale k and the lag δ; the scatter between blocks of time gives their uncertainty.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deltaid.checks.evidence import Values
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.residual import UNIT, FilteredMotion, Map
from deltaid.checks.wiring.zeros import BLOCKS
from deltaid.effects.lag_columns import APART
from deltaid.levels import STRONG
from deltaid.model.verdict import Fault, Grade, Verdict, plus_minus

# Least correlation of a velocity column with a drive's velocity; least advantage of another drive.
_TOGETHER, _BETTER = 0.9, 0.05
# Factors between a scale and 1 from which it is wrong, and doubtful.
_WRONG, _DOUBTFUL = 1.2, 1.02
_TURNING = {180 / np.pi: "degrees per second", 30 / np.pi: "rpm",
            np.pi / 180: "rad/s, and not in degrees", np.pi / 30: "rad/s, and not rpm"}  # fmt: skip
_SLIDING = {1e3: "mm/s", 1e-3: "m/s, and not in mm/s"}
_LEAVE = "leave the velocity columns out: positions are then differentiated"
_LATE = Fault(
    "velocity",
    "ms",
    "the drive smooths its velocity, or logs it at another time than its position",
    f"{_LEAVE} without delay",
)


@dataclass(frozen=True)
class Rate:
    """One velocity column compared with the derivatives of all positions."""

    drive: int  # of the column by the mapping
    nearest: int  # drive with the best correlation
    correlation: float  # with the nearest
    as_mapped: float  # correlation with the mapped drive
    scale: float  # k against the nearest
    lag: float  # δ behind it [s]
    lag_std: float

    @property
    def is_swapped(self) -> bool:
        """Whether it is clearly another drive's velocity."""
        clear = self.correlation > max(_TOGETHER, self.as_mapped + _BETTER)
        return self.nearest != self.drive and clear


def rates(motion: FilteredMotion, map: Map) -> list[Rate]:
    """Comparison of every velocity column of a moving drive."""
    d, dd, v = map.rates(motion.qd), map.rates(motion.qdd), motion.recorded
    size, out = np.linalg.norm(d, axis=0), list[Rate]()
    norm = np.outer(size, np.linalg.norm(v, axis=0))
    together = np.abs(d.T @ v) / np.where(norm > 0, norm, np.inf)
    moving = motion.moves[list(map.order)] & (size > 0)
    together[~moving] = 0.0
    for i in range(v.shape[1]):
        if not moving[i] or np.ptp(v[:, i]) == 0:
            continue
        nearest = int(np.argmax(together[:, i]))
        A = np.column_stack([d[:, nearest], dd[:, nearest]])
        inverse = np.linalg.pinv(A)
        k, b = (float(value) for value in inverse @ v[:, i])
        # Influence of each residual on b; within a block of time they may be correlated.
        influence = inverse[1] * (v[:, i] - A @ (k, b))
        blocks = np.array([part.sum() for part in np.array_split(influence, BLOCKS)])
        std = float(np.sqrt(blocks @ blocks * BLOCKS / (BLOCKS - 2)))
        correlation, as_mapped = float(together[nearest, i]), float(together[i, i])
        out.append(Rate(i, nearest, correlation, as_mapped, k, -b / k, std / abs(k)))
    return out


def velocity_verdicts(log: RemappedRecording) -> Iterator[Verdict]:
    """One verdict per cause; a good one if there is none."""
    recorded = _mapped_rates(log)
    if not recorded:
        return
    if swapped := [rate for rate in recorded if rate.is_swapped]:
        yield _order(log, swapped)
        return
    matched = [rate for rate in recorded if rate.as_mapped > _TOGETHER]
    lost = [_lost(log, rate) for rate in recorded if rate.as_mapped <= _TOGETHER]
    poor = [*_scales(log, matched), *lost, *(() if lost else _late(log, matched))]
    yield from poor or [_good(recorded)]


def _mapped_rates(log: RemappedRecording) -> list[Rate]:
    """Comparison under the best map; without columns that match the positions as they are mapped
    now, for these change with them."""
    recorded, identity = rates(log.motion, log.map), Map.identity(len(log.names))
    if not recorded or log.map == identity:
        return recorded
    matching = [
        rate.drive
        for rate in rates(log.motion, identity)
        if rate.as_mapped > _TOGETHER and 1 / _WRONG < rate.scale < _WRONG
    ]
    return [rate for rate in recorded if rate.drive not in matching]


def _scales(log: RemappedRecording, matched: list[Rate]) -> Iterator[Verdict]:
    """A verdict on drives with the same wrong unit and sign."""
    groups: dict[tuple[str, bool], list[Rate]] = {}
    for rate in matched:
        if not 1 / _DOUBTFUL < rate.scale < _DOUBTFUL:
            units = (_SLIDING if log.linear(rate.drive) else _TURNING).items()
            named = (
                u for factor, u in units if 1 / _DOUBTFUL < abs(rate.scale) / factor < _DOUBTFUL
            )
            groups.setdefault((next(named, ""), rate.scale < 0), []).append(rate)
    for (name, reversed_), group in groups.items():
        yield _scale(log, group, name, reversed_=reversed_)


def _lost(log: RemappedRecording, rate: Rate) -> Verdict:
    drive = log.names[rate.drive]
    return Verdict(
        "velocity",
        Grade.DOUBTFUL,
        f"the velocity column of {drive} goes with no drive's changes of position (correlation "
        f"{rate.correlation:.2g})",
        drive,
        "the column is of another signal, or very noisy",
        _LEAVE,
        number=rate.correlation,
    )


def _late(log: RemappedRecording, matched: list[Rate]) -> Iterator[Verdict]:
    late = [rate for rate in matched if abs(rate.lag) > max(APART, STRONG * rate.lag_std)]
    if late:
        latest = max(late, key=lambda rate: abs(rate.lag))
        seen = (
            f"velocities are {plus_minus(1e3 * abs(latest.lag), 2e3 * latest.lag_std)} ms "
            f"{'behind' if latest.lag > 0 else 'ahead of'} the changes of the positions"
        )
        yield _LATE.judged(seen, log.whose([rate.drive for rate in late]), 1e3 * latest.lag)


def _good(recorded: list[Rate]) -> Verdict:
    lag = 1e3 * max((rate.lag for rate in recorded), key=abs)
    seen = (
        f"recorded velocities are the derivatives of the positions: within "
        f"{max(abs(rate.scale - 1) for rate in recorded):.2g} in scale and {abs(lag):.2g} ms "
        "in time"
    )
    return _LATE.good(seen, lag)


def _order(log: RemappedRecording, swapped: list[Rate]) -> Verdict:
    record, columns = log.evidence, log.evidence.columns.velocity
    weakest = min(rate.correlation for rate in swapped)
    pairs = ", ".join(
        f"{columns[rate.drive].column} is that of {log.names[rate.nearest]}" for rate in swapped
    )
    moved = {
        rate.nearest: record.taken_from(rate.drive, "velocity", rate.nearest) for rate in swapped
    }
    return Verdict(
        "velocity",
        Grade.WRONG,
        f"velocity columns go with the changes of other drives' positions, by correlations of at "
        f"least {weakest:.3f}: {pairs}",
        log.whose([rate.drive for rate in swapped]),
        "velocity columns are in another order than the position columns",
        "map the velocity columns in the order of the drives",
        record.proposal({"velocity": moved}),
        weakest,
    )


def _scale(log: RemappedRecording, scaled: list[Rate], name: str, *, reversed_: bool) -> Verdict:
    """Verdict on drives whose velocities have one wrong scale, in a named unit or none."""
    scale = float(np.median([rate.scale for rate in scaled]))
    size = float(np.median([abs(rate.scale) for rate in scaled]))
    ratio, record = max(size, 1 / size), log.evidence
    whose = log.whose([rate.drive for rate in scaled])
    velocities = f"velocities of {whose}" if whose else "velocities"
    factor = min((*_TURNING, *_SLIDING), key=lambda f: abs(np.log(size / f)))
    changes: Values = {}
    for rate in scaled:
        changes[rate.drive] = record.turned("velocity", rate.drive) if reversed_ else {}
        if name:
            changes[rate.drive] |= record.in_unit("velocity", rate.drive, 1 / factor)
        elif ratio > UNIT:
            changes[rate.drive] |= record.of_motor("velocity", rate.drive, 1 / abs(rate.scale))
    cure = "declare unit, sign and gear of the velocity columns"
    if name:
        cause = f"{velocities} are in {name}"
    elif ratio > UNIT:
        cause = f"{velocities} are in another unit, or those of a motor behind a gear"
    else:
        cause = "" if reversed_ else f"{velocities} have a wrong scale, or those of another time"
        cure = cure if reversed_ else _LEAVE
    if reversed_:
        cause = f"{velocities} count the other way" + (f", and {cause}" if cause else "")
    return Verdict(
        "velocity-unit" if name or ratio > UNIT else "velocity",
        Grade.WRONG if reversed_ or ratio > _WRONG else Grade.DOUBTFUL,
        f"{velocities} are {scale:.4g} times the rate at which positions change",
        whose,
        cause,
        cure,
        record.proposal({"velocity": changes}),
        number=scale,
    )
