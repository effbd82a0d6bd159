"""One pass over recordings that gathers their information on the parameters, in constant memory.

Windows are condensed to triangles independently, on all cores, and added up in order.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.additions import Addition, Extended, extended
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.information import (
    Chunk,
    Condensed,
    Information,
    active_columns,
    chunks_of_drives,
    collect,
    condense,
    merge,
)
from deltaid.estimation.objective import noise_level
from deltaid.estimation.scatter import PlaceSums, Sums, Visits
from deltaid.identification.measured_rows import FilteredRows, MeasuredRows
from deltaid.levels import FAINT, ROUNDS, SETTLED
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import Window
from deltaid.sensors.weighings import Weighing, weighings

_Columns = Dynamics | Extended | MeasuredRows


@dataclass(frozen=True, eq=False)
class Gathered:
    """The information of recordings of one robot."""

    # consecutive blocks of equal length of each recording, whose scatter gives intervals
    parts: tuple[tuple[Information, ...], ...]
    # sums of [Y_i, τ_i]ᵀ[Y_i, τ_i] by place of the platform and drive (or channel) i
    places: Float[np.ndarray, "places rows augmented augmented"]
    information: Information  # everything together, with levels and facts once `balanced`

    @property
    def blocks(self) -> tuple[Information, ...]:
        return tuple(block for part in self.parts for block in part)

    def weighted(self, weights: Float[np.ndarray, " rows"]) -> dict[str, Sums]:
        """Sums of [Y, τ]ᵀ[Y, τ] by time and by place, with one weight a drive or channel."""
        factors = np.stack([block.factors for block in self.blocks])
        factors *= np.sqrt(weights)[:, None, None]
        stacked = factors.reshape(len(factors), -1, factors.shape[-1])
        return {
            "time": np.swapaxes(stacked, 1, 2) @ stacked,
            "place": np.einsum("i,pijk->pjk", weights, self.places),
        }


def gather_balanced(
    dynamics: Dynamics,
    recordings: Sequence[PreparedRecording],
    additions: Sequence[Addition] = (),
    load: Parameters | None = None,
    progress: Progress = lambda _: None,
) -> Gathered:
    """Information of recordings and measured values, `balanced`; otherwise as `gather_all`."""
    known = weighings(dynamics.robot)
    rows = MeasuredRows(extended(dynamics, additions), known)
    return balanced(gather_all(rows, recordings, load, progress), known)


def gather_all(
    regressor: _Columns,
    recordings: Sequence[PreparedRecording],
    load: Parameters | None = None,
    progress: Progress = lambda _: None,
    whitening: Float[np.ndarray, "dof dof"] | None = None,
) -> Gathered:
    """The information of recordings of the same robot, in blocks and by place; as `gather`."""
    rows = _measured(regressor)
    places, parts = places_of(rows, recordings), []
    for recording in recordings:
        progress(f"evaluating {recording.log.samples} samples of {recording.path}")
        parts.append(gather(rows, recording, places, load, whitening=whitening))
    return Gathered(tuple(parts), places.sums, merge(block for part in parts for block in part))


def places_of(regressor: _Columns, recordings: Iterable[PreparedRecording]) -> PlaceSums:
    reaches = np.array([recording.log.reach for recording in recordings])
    box = np.stack([reaches[:, 0].min(axis=0), reaches[:, 1].max(axis=0)])
    return PlaceSums(box, regressor.dof, len(active_columns(regressor)) + 1)


def gather(
    regressor: _Columns,
    recording: PreparedRecording,
    places: PlaceSums | None = None,
    load: Parameters | None = None,
    count: int = STRETCHES,
    whitening: Float[np.ndarray, "dof dof"] | None = None,
) -> tuple[Information, ...]:
    """The information of one recording, in `count` consecutive blocks of equal length.

    A filter applies to torques and regressor alike, and its output is thinned to the rate that the
    cut-off allows. `merge` adds up the blocks. `places`, if given, adds every sample by place. A
    whitening Σ^-½ mixes each sample's rows of all drives, so that noise of covariance Σ becomes 1.

    Load friction uses the torques of gears by parameters `load`, and is linearised about these
    (`LoadSlope`). Without them it uses measured torques, which have noise and the motors' friction.

    Raises:
        IdentificationError: the regressor is not finite somewhere.
    """
    rows = _measured(regressor)
    low_pass, robot = recording.low_pass, rows.regressor.kinematics.robot
    lost = low_pass.stride * len(low_pass.first) if low_pass else 0
    length = max(1, -(-(recording.log.samples - lost) // (recording.filter.thinned * count)))

    def share(window: Window) -> tuple[list[tuple[int, Condensed]], list[Visits]]:
        """A window's samples condensed, with the numbers of their blocks, and by place."""
        of_window = rows.filtered(window, recording, load)
        chunks = _chunks(rows, of_window, whitening)
        pieces = [
            (
                number,
                condense(
                    [(columns, samples[:, part]) for columns, samples in chunks],
                    of_window.y[:, part],
                    of_window.counted[:, part],
                ),
            )
            for number, part in _cuts(
                window.start // recording.filter.thinned, of_window.y.shape[1], length
            )
        ]
        r = robot.task.point(window.inner.z[:: recording.filter.thinned])
        return pieces, places.visits(r, chunks) if places else []

    def numbered() -> Iterator[tuple[int, Condensed]]:
        for pieces, visits in recording.evaluate(rows.regressor.kinematics, share):
            if places is not None:
                places.add(visits)
            yield from pieces

    return tuple(
        collect(
            rows, (condensed for _, condensed in block), str(recording.path), rows.dof - rows.drives
        )
        for _, block in groupby(numbered(), key=lambda piece: piece[0])
    )


def _measured(regressor: _Columns) -> MeasuredRows:
    if isinstance(regressor, MeasuredRows):
        return regressor
    return MeasuredRows(regressor if isinstance(regressor, Extended) else extended(regressor))


def _chunks(
    rows: MeasuredRows, filtered: FilteredRows, whitening: Float[np.ndarray, "dof dof"] | None
) -> list[Chunk]:
    """Each drive's and channel's rows of [Y, τ], or their mixtures."""
    if whitening is None:
        return chunks_of_drives(rows, filtered.entries, filtered.y)
    places, columns = rows.regressor_pattern
    full = np.zeros((rows.dof, len(rows.active) + 1, filtered.y.shape[1]))
    full[places, np.searchsorted(rows.active, columns)] = filtered.entries
    full[:, -1] = filtered.y
    every = np.arange(full.shape[1])
    return [(every, mixed) for mixed in np.einsum("ij,jks->iks", whitening, full)]


def _cuts(start: int, count: int, length: int) -> Iterator[tuple[int, slice]]:
    """Samples start … start + count cut where blocks of `length` end: block number and part."""
    done = 0
    while done < count:
        number, inside = divmod(start + done, length)
        stop = min(count, done + length - inside)
        yield number, slice(done, stop)
        done = stop


def balanced(gathered: Gathered, weighings: Sequence[Weighing]) -> Gathered:
    """The same with channels of sensors weighted by their noise, and with weighings.

    The fit scales each drive by its largest torque, and σ̂ is the noise as a share of that. The
    scale of a sensor's channel is its residual's root mean square over σ̂, by turns with the
    residual (iterated generalised least squares). A fact cᵀp = v ± σ has the row (σ̂/σ) [c, v]. So
    all rows have the noise σ̂.
    """
    information = gathered.information
    if not (information.channels or weighings):
        return gathered
    sigma = max(noise_level(information), FAINT)
    rows = [
        sigma / fact.std * np.append(fact.over(information.columns), fact.value)
        for fact in weighings
    ]
    facts = np.reshape(rows, (len(rows), len(information.columns) + 1))
    known = replace(information, facts=facts)
    return replace(gathered, information=replace(known, levels=_levels(known, sigma)))


def _levels(information: Information, sigma: float) -> Float[np.ndarray, " channels"]:
    """The scale of each channel."""
    channels = slice(information.drives.stop, None)
    largest = information.torque_max[channels]
    levels = largest.copy()
    for _ in range(ROUNDS if information.channels else 0):
        now = replace(information, levels=levels)
        residual = np.linalg.norm(now.factors @ np.append(-now.problem.x, 1.0), axis=1)
        # Degrees of freedom that the fit takes from each channel.
        leverage = now.factors[:, :, :-1] @ now.problem.inverse
        freedom = np.sum(leverage**2, axis=(1, 2)) * now.weights
        rms = residual / np.sqrt(np.maximum(now.samples - freedom, 1.0))
        before, levels = levels, np.maximum(rms[channels], FAINT * largest) / sigma
        if np.allclose(levels, before, rtol=SETTLED, atol=0):
            break
    return levels
