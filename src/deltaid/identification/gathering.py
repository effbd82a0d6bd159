"""One pass over recordings that gathers their information on the parameters, in constant memory.

Windows are condensed to triangles apart from each other, on all cores, and added up in order.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters, Regressor
from deltaid.estimation.additions import Extended, entries
from deltaid.estimation.information import (
    Chunk,
    Condensed,
    Information,
    active_columns,
    chunks_of_drives,
    collect,
    condense,
    merge,
    triangle,
)
from deltaid.estimation.places import Places, Visits
from deltaid.identification.load_slope import LoadSlope
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples, Window

# Blocks that a log is cut into: enough to judge by their scatter, each still much longer than the
# filter's memory.
BLOCKS = 40

_Columns = Regressor | Extended | MeasuredRows
_Values = Float[np.ndarray, "entries samples"]
_Torques = Float[np.ndarray, "dof samples"]
_Chunks = Callable[[_Values, _Torques], Sequence[Chunk]]


@dataclass(frozen=True, eq=False)
class Gathered:
    """The information of recordings of one robot."""

    # for each recording its consecutive blocks of equal length, whose scatter gives intervals
    parts: tuple[tuple[Information, ...], ...]
    places: Float[np.ndarray, "places rows augmented augmented"]  # the same samples place by place
    # levels, facts: as of `Information`, for everything together (`balance`)
    levels: Float[np.ndarray, " channels"] | None = None
    facts: Float[np.ndarray, "facts augmented"] | None = None
    # everything together, where it is known more exactly than in parts
    whole: Information | None = None

    @property
    def blocks(self) -> tuple[Information, ...]:
        return tuple(block for part in self.parts for block in part)

    @cached_property
    def information(self) -> Information:
        whole = self.whole or merge(self.blocks)
        return replace(whole, levels=self.levels, facts=self.facts)


def gather_all(
    regressor: _Columns,
    recordings: Sequence[Recording],
    load: Parameters | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Gathered:
    """The information of recordings of the same robot, in blocks and by place; as `gather`."""
    rows = _measured(regressor)
    places, parts = places_of(rows, recordings), []
    for recording in recordings:
        progress(f"evaluating {recording.log.samples} samples of {recording.path}")
        parts.append(gather(rows, recording, places, load))
    return Gathered(tuple(parts), places.sums)


def gather(
    regressor: _Columns,
    recording: Recording,
    places: Places | None = None,
    load: Parameters | None = None,
    count: int = BLOCKS,
) -> tuple[Information, ...]:
    """The information of one recording, in `count` consecutive blocks of equal length.

    With a filter, the same filter goes over torques and regressor, and what remains is thinned to
    the rate that the cut-off allows. `merge` puts the blocks together. `places`, if given, takes in
    every sample as well.

    Friction that depends on load uses what gears carry by parameters `load`, and is linear about
    these (`load_slope`). Without them it uses the measured torques, whose noise then stands on both
    sides of the equation, and with it the motors' own friction.

    Raises:
        IdentificationError: the regressor is not finite somewhere.
    """
    rows = _measured(regressor)

    def chunks(values: _Values, tau: _Torques) -> list[Chunk]:
        return chunks_of_drives(rows.regressor, values, tau, rows.active)

    return tuple(
        collect(rows, block, str(recording.path), rows.channels)
        for block in _blocks(rows, recording, places, chunks, load, count)
    )


def whitened(
    regressor: Regressor | Extended,
    recording: Recording,
    whitening: Float[np.ndarray, "dof dof"],
    places: Places | None = None,
) -> tuple[Float[np.ndarray, "rank augmented"], ...]:
    """Factors of W^½ [Ȳ, τ̄] with W = Σ⁻¹ full over the drives of a sample; `whitening` is Σ^-½.

    One factor a block, as in `gather`. A second pass over the recording, because rows of different
    drives are mixed.
    """
    columns = active_columns(regressor)
    rows, entries = regressor.regressor_pattern
    where, everything = np.searchsorted(columns, entries), np.arange(len(columns) + 1)

    def chunks(values: _Values, tau: _Torques) -> list[Chunk]:
        full = np.zeros((regressor.dof, len(everything), values.shape[1]))
        full[rows, where] = values
        full[:, -1] = tau
        return [(everything, drive) for drive in np.einsum("ij,jks->iks", whitening, full)]

    factors = []
    for block in _blocks(MeasuredRows(regressor), recording, places, chunks):
        factor = np.zeros((0, len(everything)))
        for part in block:
            factor = triangle(np.vstack([factor, *(R for _, R in part.triangles)]))
        factors.append(factor)
    return tuple(factors)


def places_of(regressor: _Columns, recordings: Iterable[Recording]) -> Places:
    """Empty places over the range that recordings cover together."""
    return Places.over(recordings, regressor.dof, len(active_columns(regressor)) + 1)


def _measured(regressor: _Columns) -> MeasuredRows:
    return regressor if isinstance(regressor, MeasuredRows) else MeasuredRows(regressor)


def _blocks(
    rows: MeasuredRows,
    recording: Recording,
    places: Places | None,
    chunks: _Chunks,
    load: Parameters | None = None,
    count: int = BLOCKS,
) -> Iterator[Iterator[Condensed]]:
    """The samples of each block of a recording, all blocks of equal length but the last."""
    regressor, low_pass = rows.regressor, recording.low_pass
    lost = low_pass.stride * len(low_pass.first) if low_pass else 0
    length = max(1, -(-(recording.log.samples - lost) // (recording.thinned * count)))
    robot = regressor.kinematics.robot

    def share(window: Window) -> tuple[list[tuple[int, Condensed]], list[Visits]]:
        """A window's samples condensed, with the numbers of their blocks, and by place."""
        values, tau, z = thinned(regressor, recording, window, load)
        counted, sensed = window.counted(window.thinned), rows.shown(window, recording)
        measured = [tau, counted]
        if sensed is not None:
            measured = [np.vstack([tau, sensed.y]), np.vstack([counted, sensed.counted])]

        def chunks_of(part: slice) -> list[Chunk]:
            of_sensors = rows.chunks(sensed, part) if sensed is not None else []
            return [*chunks(values[:, part], tau[:, part]), *of_sensors]

        pieces = [
            (number, condense(chunks_of(part), *(rows[:, part] for rows in measured)))
            for number, part in _cuts(window.start // window.thinned, tau.shape[1], length)
        ]
        return pieces, places.visits(robot.task.point(z), chunks_of(slice(None))) if places else []

    def numbered() -> Iterator[tuple[int, Condensed]]:
        for pieces, visits in recording.evaluate(regressor.kinematics, share):
            if places is not None:
                places.add(visits)
            yield from pieces

    for _, block in groupby(numbered(), key=lambda piece: piece[0]):
        yield (condensed for _, condensed in block)


def thinned(
    regressor: Regressor | Extended, recording: Recording, window: Window, load: Parameters | None
) -> tuple[_Values, _Torques, Float[np.ndarray, "samples dof"]]:
    """Nonzero regressor entries and torques, weighted, filtered and thinned alike, and z there."""
    drives, _ = regressor.regressor_pattern
    all_drives = np.arange(regressor.dof)
    slope = LoadSlope.at(regressor, load) if load is not None else None

    def values(w: Samples) -> _Values:
        if load is None or slope is None:
            return w.weigh(entries(regressor, w, w.tau + w.carried, recording), drives)
        x = regressor.carried(w.z, w.qd, w.qdd, load) + w.carried
        Y = entries(regressor, w, x, recording)
        return w.weigh(slope.scaled(Y, slope.factor(w, x)), drives)

    def torques(w: Samples) -> _Torques:
        if load is None or slope is None:
            return w.weighted(w.tau.T, all_drives)
        carried = regressor.carried(w.z, w.qd, w.qdd, load)
        return w.weighted(w.tau.T + slope.factor(w, carried + w.carried) * carried.T, all_drives)

    return window.filtered(values), window.filtered(torques), window.own.z[:: window.thinned]


def _cuts(start: int, count: int, length: int) -> Iterator[tuple[int, slice]]:
    """Samples start … start + count cut where blocks of `length` end: block number and part."""
    done = 0
    while done < count:
        number, inside = divmod(start + done, length)
        stop = min(count, done + length - inside)
        yield number, slice(done, stop)
        done = stop
