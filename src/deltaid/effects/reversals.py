"""The lag of each drive's torque by its steps at reversals, where friction changes its sign.

Smooth errors, as of a friction law, load or gain, look like a lag in other rows but not here. A fit
excludes these rows, so their result enters it as the prior of the lag. The shapes of steps and
their least squares are in `torque_steps`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import slope
from deltaid.effects.torque_steps import (
    LONGEST,
    NEAR,
    Steps,
    behind_filter,
    blurred,
    is_abrupt,
    is_rounded,
    locally,
    located,
    misfit,
    sharp,
)
from deltaid.estimation.additions import Addition, torques_of
from deltaid.estimation.traces import Delay, Trace
from deltaid.recording.windows import WINDOW, SampleBlock

# Samples to either side of a reversal that are used beyond the range of lags; and samples next to
# it that may have no weight, for masks exclude reversals.
_AROUND, _MASKED = 8, 3
# Half the range of the first search about the known lag [s].
_FAR = 0.012
# Largest misfit of samples next to a sharp step, in steps.
_SHARP = 0.08
# Share of a sample by which the instants of a row's torque and position may differ.
_APART = 0.1

Torques = Float[np.ndarray, "dof _"]  # each stretch as long as it is


class ReversalLags(NamedTuple):
    """Lags of the drives of one recording by reversals."""

    values: Delay  # [s]
    deviation: Delay  # their standard deviations; infinite where reversals give no lag [s]
    filtered: Bool[np.ndarray, " dof"]  # whether steps passed a filter
    doubtful: Bool[np.ndarray, " dof"]  # whether steps fit neither a sharp step nor a filter
    blur: Delay  # time before and after the lag over which steps are blurred; zero if not [s]


class _DriveLag(NamedTuple):
    """The same of one drive."""

    value: float
    deviation: float = np.inf
    filtered: bool = False
    doubtful: bool = False
    blur: float = 0.0


def lags_of_reversals(
    trace: Trace, additions: Sequence[Addition], p: Parameters, known: Delay
) -> ReversalLags:
    """The lag of every drive by its reversals; `known` and p are lags [s] and parameters by all
    other rows."""
    modelled = [_modelled(trace, additions, p, stretch) for stretch in trace.stretches]
    held = trace.recording.repairs.hold or (False,) * len(known)  # interpolated, so no step is left
    lags = [
        _DriveLag(by_rows)
        if held[i]
        else _lag_of(partial(_about_reversals, trace, modelled, i), by_rows, trace.low_pass.rate)
        for i, by_rows in enumerate(known.tolist())
    ]
    return ReversalLags(*(np.array(values) for values in zip(*lags, strict=True)))


def _lag_of(steps_about: Callable[[float, float], Steps], by_rows: float, rate: float) -> _DriveLag:
    """The lag of a drive.

    Args:
        steps_about: returns samples about the drive's reversals, for a lag and the reach of
            others [s].
        by_rows: lag by all other rows [s].
        rate: samples per second.
    """
    period = 1.0 / rate
    far, near = _FAR + period, NEAR + period
    # Lags by other rows may be something else, as motors that saturate: no lag is in reach too.
    middle, reach = 0.5 * by_rows, 0.5 * abs(by_rows) + far
    rough = located(steps_about(middle, reach), middle, reach)
    about = by_rows if rough is None else rough[0]
    steps = steps_about(about, near)
    lag = None if rough is None else located(steps, about, near)
    apart = period * _APART / np.sqrt(max(len(steps.jump), 1))
    if lag is not None:
        local = locally(steps, sharp(steps.after, lag[0]))
        off = misfit(local, steps, lag[0])
        at_once = off < _SHARP and is_abrupt(local, steps, lag[0])
        if at_once and (off > 0 or not is_rounded(local, steps, lag[0], period)):
            return _DriveLag(lag[0], float(np.hypot(lag[1], max(apart, off * period))))
    by_blur = blurred(steps_about(about, near + 0.5 * LONGEST), about, period)
    if by_blur is not None:
        value, deviation, blur = by_blur
        return _DriveLag(value, deviation, blur=blur)
    if lag is None:
        return _DriveLag(by_rows)
    lag = behind_filter(steps, about, period)
    if lag is None:
        return _DriveLag(by_rows, doubtful=True)
    return _DriveLag(lag[0], float(np.hypot(lag[1], apart)), filtered=True)


def _modelled(
    trace: Trace, additions: Sequence[Addition], p: Parameters, stretch: SampleBlock
) -> tuple[Torques, Torques]:
    """Torques of the model along a stretch, and the part that is the drive's own friction."""
    layout, names = trace.dynamics.layout, trace.dynamics.robot.drives
    drives, columns = trace.pattern(additions)
    owners = {k: t.owner for k, t in enumerate(layout.parameters) if t.kind == "friction"}
    pairs = zip(drives.tolist(), columns.tolist(), strict=True)
    own = np.array([owners.get(k) == names[i] for i, k in pairs])
    parts = list[tuple[Torques, Torques]]()
    for first in range(0, len(stretch.time), WINDOW):
        values = trace.entries(stretch.part(slice(first, first + WINDOW)), additions)
        tau = torques_of((drives, columns), len(names), values, p)
        friction = torques_of((drives[own], columns[own]), len(names), values[own], p)
        parts.append((tau, friction))
    tau, friction = (np.hstack(part) for part in zip(*parts, strict=True))
    return tau, friction


def _about_reversals(
    trace: Trace,
    modelled: Sequence[tuple[Torques, Torques]],
    drive: int,
    known: float,
    reach: float,
) -> Steps:
    """Samples of a drive near those of its reversals that lie well apart from others."""
    rate, parts = trace.low_pass.rate, list[tuple[np.ndarray, ...]]()
    late, width = round(known * rate), int(np.ceil(reach * rate)) + _AROUND
    offsets = np.arange(-width + 1, width + 1)
    for stretch, (tau, friction) in zip(trace.stretches, modelled, strict=True):
        speed, counts = stretch.qd[:, drive], stretch.weights[:, drive] > 0
        before = np.flatnonzero(speed[:-1] * speed[1:] < 0)
        first, last = width + max(0, -late), len(speed) - 1 - width - max(0, late)
        sure = (before >= first) & (before <= last)
        sure &= np.diff(before, prepend=-np.inf) > 2 * width
        sure &= np.diff(before, append=np.inf) > 2 * width
        before = before[sure]
        for shift in (0, late):  # where the motion, and where the torque is read
            off = offsets[(offsets + shift <= -_MASKED) | (offsets + shift > _MASKED)]
            before = before[np.all(counts[before[:, None] + off + shift], axis=1)]
        rows = before[:, None] + offsets
        share = speed[before] / (speed[before] - speed[before + 1])
        jump = friction[drive, before + 1] - friction[drive, before]
        smooth = tau[drive, rows] - 0.5 * jump[:, None] * np.where(offsets > 0, 1.0, -1.0)
        smooth += slope(smooth) * (late - known * rate)  # at the instant of each torque
        residual = stretch.tau[rows + late, drive] - smooth
        rise = rate * np.abs(speed[before + 1] - speed[before])
        parts.append(((offsets + late - share[:, None]) / rate, residual, jump, rise))
    return Steps(*(np.concatenate(part) for part in zip(*parts, strict=True)))
