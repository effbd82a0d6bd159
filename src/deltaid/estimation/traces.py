"""A recording in memory (`Trace`): motion and torques at the full rate, to be shifted in time or to
get additional columns before low-pass and thinning."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import lfilter

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition, Values, entries, extended
from deltaid.estimation.information import active_columns
from deltaid.recording.delay import LagGrowth, Shift
from deltaid.recording.filter import LowPass
from deltaid.recording.log import MOST_WINDOWS
from deltaid.recording.masks.masks import least_about
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.spectrum import apply
from deltaid.recording.windows import WINDOW, SampleBlock

# Time constants after which the initial state of a filter does not matter: e⁻¹⁰.
_FORGOTTEN = 10.0
# Longest time step within a stretch, over the usual one.
GAP = 1.5
# Largest lag by which torques are read later or earlier [s].
LARGEST_LAG = 0.03

Delay = Float[np.ndarray, " dof"]


@dataclass(frozen=True, eq=False)
class Trace:
    """A recording's motion and torques in memory."""

    dynamics: Dynamics
    load: Parameters  # as of `carried`, by which load friction computes the torques of gears
    stretches: tuple[SampleBlock, ...]  # runs without a gap; motion filtered, torques as recorded
    low_pass: LowPass
    recording: PreparedRecording
    # time constants of each drive's first-order filter, which the model's torques pass too [s]
    constants: tuple[float, ...] = ()

    def filtered(
        self,
        quantity: Callable[[SampleBlock], Values],
        drives: Int[np.ndarray, " channels"],
        margin: int = 0,
    ) -> Values:
        """m(t) x(t), low-passed and thinned, for x by `quantity` and the weight m of each channel's
        drive.

        Evaluated in blocks to save memory; x is wrong in `margin` samples at either end of one.
        """
        low_pass, parts = self.low_pass, [np.zeros((len(drives), 0))]
        support = len(low_pass.lead) + low_pass.stride * (len(low_pass.smooth) - 1)
        at_once = max(1, WINDOW // low_pass.thinned)
        for run in self.stretches:
            rows, count = len(run.time), _outputs(low_pass, len(run.time))
            for start in range(0, count, at_once):
                outputs = min(at_once, count - start)
                first = start * low_pass.thinned
                last = first + (outputs - 1) * low_pass.thinned + support
                low, high = max(0, first - margin), min(rows, last + margin)
                x = quantity(run.part(slice(low, high)))[:, first - low : last - low]
                led = low_pass.leading(run.part(slice(first, last)).weighted(x, drives))
                parts.append(apply(low_pass.smooth, led, low_pass.decimation)[:, :outputs])
        return np.concatenate(parts, axis=1)

    def columns(
        self,
        quantity: Callable[[SampleBlock], Values],
        pattern: tuple[np.ndarray, np.ndarray],
        count: int,
        margin: int = 0,
    ) -> Float[np.ndarray, "dof thinned columns"]:
        """Entries as of `filtered`, placed by the drive and column of each."""
        rows, columns = pattern
        entries = self.filtered(quantity, rows, margin)
        out = np.zeros((self.dynamics.dof, entries.shape[1], count))
        out[rows, :, columns] = entries
        return out

    def torques(self) -> Values:
        return self.filtered(lambda w: w.tau.T, np.arange(self.dynamics.dof))

    def regressor(
        self, additions: Sequence[Addition] = ()
    ) -> Float[np.ndarray, "dof thinned columns"]:
        """The active columns of Y, filtered; those of additions follow those of the robot."""
        regressor = extended(self.dynamics, additions)
        (rows, columns), active = regressor.regressor_pattern, active_columns(regressor)
        margin = self.settling if self.constants else 1
        pattern = rows, np.searchsorted(active, columns)
        return self.columns(
            lambda w: self.behind(self.entries(w, additions), rows), pattern, len(active), margin
        )

    def pattern(self, additions: Sequence[Addition] = ()) -> tuple[np.ndarray, np.ndarray]:
        return extended(self.dynamics, additions).regressor_pattern

    def entries(self, w: SampleBlock, additions: Sequence[Addition] = ()) -> Values:
        """Entries of Y along some samples, those of additions behind those of the robot."""
        load = None
        if self.dynamics.robot.load_drives:
            load = self.carried(w, self.load)
        return entries(extended(self.dynamics, additions), w, load, self.recording)

    def carried(self, w: SampleBlock, p: Parameters) -> Float[np.ndarray, "samples dof"]:
        """Torques that gears carry along some samples, by p of the robot or of all columns, and
        with held loads."""
        return extended(self.dynamics).carried(w.z, w.qd, w.qdd, p) + w.carried

    def behind(self, x: Values, drives: Int[np.ndarray, " channels"]) -> Values:
        """Channels behind the filters of their drives, 1 / (1 + T s), from a steady state on."""
        for i, constant in enumerate(self.constants):
            if constant:
                own = drives == i
                x = x if x.flags.owndata else x.copy()
                T = constant * self.low_pass.rate
                a, pole = 1 / (1 + 2 * T), (2 * T - 1) / (2 * T + 1)
                first = x[own, :1]
                x[own] = lfilter([a, a], [1.0, -pole], x[own] - first) + first
        return x

    @property
    def settling(self) -> int:
        """Samples until the initial state of filters does not matter, and two for slopes."""
        return 2 + int(np.ceil(_FORGOTTEN * max(self.constants, default=0.0) * self.low_pass.rate))

    @property
    def counted(self) -> Float[np.ndarray, " dof"]:
        """Share of the samples of each drive that count: of white noise, filtered rows keep the
        mean square of the weights."""
        weights = np.concatenate([run.weights for run in self.stretches])
        return np.mean(weights**2, axis=0)

    def is_long(self, lost: int) -> bool:
        """Whether rows remain if each stretch loses so many samples."""
        return any(_outputs(self.low_pass, len(run.time) - lost) > 0 for run in self.stretches)

    def shifted(self, delay: Delay, growth: LagGrowth | None = None) -> "Trace":
        """The same with torques read `delay` [s] later, as `Repairs` does; `growth` is that of
        delays with time."""
        rate = self.low_pass.rate
        shift = Shift.of_delays(delay.tolist(), rate, (), growth)
        parts = (_shifted(run, shift, rate) for run in self.stretches)
        long = tuple(run for run in parts if _outputs(self.low_pass, len(run.time)) > 0)
        return replace(self, stretches=long)

    def model(self, p: Parameters) -> Float[np.ndarray, "dof thinned"]:
        dynamics = self.dynamics
        return self.filtered(
            lambda w: dynamics.torque(w.z, w.qd, w.qdd, p).T, np.arange(dynamics.dof)
        )

    def motion(self) -> SampleBlock:
        """The motion at the filtered and thinned samples, with filtered weights."""
        low_pass, parts = self.low_pass, []
        middle = low_pass.lead_half + low_pass.stride * low_pass.half
        for run in self.stretches:
            count = _outputs(low_pass, len(run.time))
            parts.append(run.part(slice(middle, None, low_pass.thinned)).part(slice(count)))
        ones = self.filtered(lambda w: np.ones_like(w.tau.T), np.arange(self.dynamics.dof))
        return replace(_joined(parts), weights=ones.T)


def trace(
    dynamics: Dynamics,
    recording: PreparedRecording,
    load: Parameters,
    *,
    cutoff: float | None,
    windows: int | None = None,
) -> Trace:
    """A recording in memory, or so many windows of `WINDOW` rows spread over a long one.

    It is filtered by a cut-off [Hz], None for the log's own.

    Velocities and accelerations come from positions, even where recorded, so that their errors have
    no influence. Reversals do not count: steps of friction are known only to half a sample.

    Raises:
        RecordingError: the log is too short or too slow to be differentiated and read at any lag.
    """
    log = recording.log
    columns = log.columns.without_rates
    # `keep_all` concerns reversals only; masks of the log stay.
    recording = recording.brief.changed(cutoff, columns=columns, keep_all=False)
    assert recording.low_pass is not None  # positions alone are always filtered
    windows_kept = recording.spread(dynamics.kinematics, windows or MOST_WINDOWS)
    joined = _joined([window.inner for window in windows_kept])
    gaps = np.flatnonzero(np.diff(joined.time) > GAP / log.rate) + 1
    stretches = tuple(
        joined.part(slice(first, last))
        for first, last in pairwise([0, *gaps.tolist(), len(joined.time)])
        if _outputs(recording.low_pass, last - first) > 0
    )
    if not joined.weights.any():
        raise RecordingError(
            "has no row that counts", where=str(log.path), cure="give a recording that moves more"
        )
    record = Trace(dynamics, load, stretches, recording.low_pass, recording)
    farthest = Shift.of_delays((LARGEST_LAG, -LARGEST_LAG), log.rate, (), None)
    if not record.is_long(sum(farthest.reach)):
        raise RecordingError(
            "is too short to be filtered, or has too many gaps",
            where=str(log.path),
            cure="give a longer recording",
        )
    return record


def _shifted(stretch: SampleBlock, shift: Shift, rate: float) -> SampleBlock:
    """Samples with torques read later; weights exclude reversals where they were before."""
    before, after = shift.reach
    motion, dof = (stretch.z, stretch.qd, stretch.qdd, stretch.carried), stretch.z.shape[1]
    # Torques of loads belong to the time of the motion, not to that of recorded torques.
    torques = stretch.tau + stretch.carried
    wide = np.hstack([stretch.time[:, None], *motion, torques, stretch.weights])
    if len(wide) <= before + after:
        return stretch.part(slice(0))
    rows = shift.rows(wide, 4 * dof, rate)
    time, z, qd, qdd, carried, tau, weights = np.split(rows, np.cumsum([1, *[dof] * 5]), axis=1)
    for i, smear in enumerate(shift.smear):
        reach = int(np.ceil(float(smear + (shift.common != 0.0))))
        weights[:, [i]] = least_about(weights[:, [i]], reach)
    kept = stretch.part(slice(before, len(wide) - after))
    values = {"time": time[:, 0], "z": z, "qd": qd, "qdd": qdd, "carried": carried}
    return replace(kept, **values, tau=tau - carried, weights=weights)


def _joined(parts: Sequence[SampleBlock]) -> SampleBlock:
    return SampleBlock(
        *(np.concatenate([getattr(w, field.name) for w in parts]) for field in fields(SampleBlock))
    )


def _outputs(low_pass: LowPass, rows: int) -> int:
    between = (rows - len(low_pass.lead)) // low_pass.stride + 1
    return max(0, (between - len(low_pass.smooth)) // low_pass.decimation + 1)
