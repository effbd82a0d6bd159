"""Measured and predicted torques of a recording, reduced for figures in constant memory.

Filtered signals are thinned without loss to the rate that the cut-off allows. If that is still more
than a figure can show, each stretch of equal length is represented by the sample with its largest
residual, so that outliers stay visible; figures of distributions use even thinning. Functions at
the end select the samples that a figure draws.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy import signal

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.identification.torque_error import PredictedTorques, predict
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.parameter import JointUnits

# Largest number of points of a curve: a screen has fewer columns.
POINTS = 4000
# Points of a comparison over time, enough to zoom in.
_SHOWN = 20_000
_SEGMENT = 1024  # samples in a segment of a spectrum


@dataclass(frozen=True)
class TorqueComparison:
    """Torques over time, residuals for statistics, and mean spectra of one recording.

    Attributes:
        time [s], measured, predicted [N m]: filtered samples to draw over time; NaN where most of
            the filter's samples are excluded.
        stretch: number of (thinned) samples that each of them represents.
        speed [rad/s], residual [N m]: evenly thinned samples, to draw over speed and for
            statistics; NaN likewise.
        frequency [Hz], measured_density, residual_density [N m/√Hz]: amplitude spectra of the
            recorded torque and of the model's residual.
        cutoff: of the filter [Hz], None without one.
        events: first and last time [s] of stretches that are excluded because of events.
        drives: units of each drive.
    """

    time: Float[np.ndarray, " shown"]
    measured: Float[np.ndarray, "shown dof"]
    predicted: Float[np.ndarray, "shown dof"]
    stretch: int
    speed: Float[np.ndarray, "counted dof"]
    residual: Float[np.ndarray, "counted dof"]
    frequency: Float[np.ndarray, " frequencies"]
    measured_density: Float[np.ndarray, "frequencies dof"]
    residual_density: Float[np.ndarray, "frequencies dof"]
    cutoff: float | None
    events: Float[np.ndarray, "events 2"]
    drives: dict[str, JointUnits]


def compare(dynamics: Dynamics, p: Parameters, recording: PreparedRecording) -> TorqueComparison:
    """Data for figures of a model's torques along a recording, in one pass."""
    log, spectrum = recording.log, _Spectrum(recording.log.rate)
    stretch = stretch_length(log.samples, recording.filter.thinned * _SHOWN)
    scale = np.where(log.torque_max > 0, log.torque_max, 1.0)
    worst, first = list[np.ndarray](), list[np.ndarray]()
    for rows in _stretches(_thinned(dynamics, p, recording, spectrum), stretch):
        residual = np.abs(np.nan_to_num(rows[:, :, 1] - rows[:, :, 2])) / scale
        worst.append(rows[np.arange(len(rows)), residual.max(axis=2).argmax(axis=1)])
        first.append(rows[:, 0])
    shown, counted = np.concatenate(worst), np.concatenate(first)
    return TorqueComparison(
        shown[:, 0, 0],
        shown[:, 1],
        shown[:, 2],
        stretch,
        counted[:, 3],
        counted[:, 1] - counted[:, 2],
        *spectrum.densities(),
        recording.cutoff,
        np.array([(span.first, span.last) for span in recording.repairs.left_out]).reshape(-1, 2),
        dynamics.robot.drive_units,
    )


def _thinned(
    dynamics: Dynamics, p: Parameters, recording: PreparedRecording, spectrum: "_Spectrum"
) -> Iterator[Float[np.ndarray, "samples 4 dof"]]:
    """Time (in every drive's column), measured, predicted and speed, at the filter's rate."""
    step, apart = recording.filter.thinned, recording.filter.stride
    for part in predict(dynamics, p, recording):
        spectrum.add(part)
        time = np.repeat(part.time[:, None], dynamics.dof, axis=1)
        gain = np.where(part.counted > 0.5, part.gain, np.nan)
        filtered = np.stack([part.filtered_measured, part.filtered_predicted]) / gain
        yield np.stack([time[::step], *filtered[:, :: step // apart], part.speed[::step]], axis=1)


def _stretches(
    blocks: Iterator[Float[np.ndarray, "samples 4 dof"]], length: int
) -> Iterator[Float[np.ndarray, "stretches length 4 dof"]]:
    """The samples in stretches of equal length; the last one may be shorter."""
    rest = np.zeros(0)
    for block in blocks:
        rows = np.concatenate([rest, block]) if len(rest) else block
        whole = len(rows) // length * length
        rest = rows[whole:]
        if whole:
            yield rows[:whole].reshape(-1, length, *rows.shape[1:])
    if len(rest):
        yield rest[None]


class _Spectrum:
    """Welch's spectra of torque and residual, averaged over the windows of a recording."""

    def __init__(self, rate: float) -> None:
        self._rate, self._length, self._segments = rate, 0, 0
        self._power: Any = 0.0

    def add(self, part: PredictedTorques) -> None:
        """Add consecutive samples as recorded; a window too short for a segment is ignored."""
        samples = len(part.time)
        self._length = self._length or min(_SEGMENT, samples)
        if samples >= self._length:
            both = part.weights * np.stack([part.measured, part.measured - part.predicted])
            _, power = signal.welch(both, self._rate, nperseg=self._length, axis=1)
            before, segments = self._segments, 2 * samples // self._length - 1  # overlap by half
            self._segments += segments
            self._power = (self._power * before + power * segments) / self._segments

    def densities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequencies without zero, and the square roots of both power densities."""
        measured, residual = np.sqrt(self._power)[:, 1:]
        return np.fft.rfftfreq(self._length, 1 / self._rate)[1:], measured, residual


def stretch_length(samples: int, most: int) -> int:
    """Samples of a stretch, for at most `most` stretches."""
    return max(1, -(-samples // most))


def even_rows(samples: int, most: int) -> slice:
    """At most `most` equidistant rows, for scatter plots."""
    return slice(None, None, stretch_length(samples, most))


def peak_rows(size: Float[np.ndarray, " samples"], most: int) -> Int[np.ndarray, " rows"]:
    """Row of the largest size in each of at most `most` stretches; NaN counts as the smallest."""
    return _largest(size, stretch_length(len(size), most))


def extreme_rows(values: Float[np.ndarray, " samples"], length: int) -> Int[np.ndarray, " rows"]:
    """Rows of the least and the largest value of each stretch of `length` samples, in order.

    NaN is selected only if a stretch holds nothing else.
    """
    return np.sort(np.concatenate([_largest(-values, length), _largest(values, length)]))


def _largest(values: Float[np.ndarray, " samples"], length: int) -> Int[np.ndarray, " rows"]:
    blocks = np.full((-(-len(values) // length), length), -np.inf)
    blocks.flat[: len(values)] = np.where(np.isnan(values), -np.inf, values)
    return np.arange(0, len(values), length) + blocks.argmax(axis=1)
