"""Everything a fit needs from any number of samples: triangular factors of [Ȳ, τ̄], one a drive.

For drive i let A_i = [Y_i, τ_i] hold its rows of all samples. Its QR factor R_i with
R_iᵀ R_i = A_iᵀ A_i is all that least squares, (15) and the torque error of any p ever use. Factors
of chunks stack and factor again (tall-skinny QR), so memory stays constant, results add up over
chunks, logs and machines, and no digits are lost to normal equations.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from deltaid.dynamics.dynamics import Parameters, Regressor
from deltaid.errors import IdentificationError
from deltaid.identification.places import Chunk, Places
from deltaid.recording.filter import LowPass, apply
from deltaid.recording.log import Log
from deltaid.recording.windows import WINDOW, windows

# Entries of a matrix that is factored at once. Above 8192 OpenBLAS divides each column's step among
# threads, which for matrices this narrow takes longer, and very much longer where other work shares
# the cores.
_PANEL = 7000

# Blocks that a log is cut into: enough to judge by their scatter, each still much longer than the
# filter's memory.
BLOCKS = 40

# Nonzero regressor entries and torques of some samples.
_Piece = tuple[Float[np.ndarray, "entries samples"], Float[np.ndarray, "dof samples"]]


@dataclass(frozen=True)
class Information:
    """What a recording says about the parameters.

    Attributes:
        columns: the parameters (positions in p) that the factors' columns stand for; all others
            have no effect on torques.
        factors: for each drive a matrix F with Fᵀ F = [Y_i, τ_i]ᵀ [Y_i, τ_i]; τ is the last column.
        samples: number of samples s behind it.
        torque_max: largest |τ| of each drive.
    """

    columns: Int[np.ndarray, " columns"]
    factors: Float[np.ndarray, "dof augmented augmented"]
    samples: int
    torque_max: Float[np.ndarray, " dof"]

    def weighted(
        self, weights: Float[np.ndarray, " dof"]
    ) -> Float[np.ndarray, "augmented augmented"]:
        """Factor of W^½ [Ȳ, τ̄] with one weight a drive: rows of drive i times √weights_i."""
        scaled = self.factors * np.sqrt(weights)[:, None, None]
        return triangle(scaled.reshape(-1, scaled.shape[2]))

    def rms(self, p: Parameters) -> Float[np.ndarray, " dof"]:
        """Root mean square of τ_i − Y_i p for each drive."""
        residual = self.factors @ np.append(-p[self.columns], 1.0)
        return np.linalg.norm(residual, axis=1) / np.sqrt(self.samples)

    def torque_rms(self) -> Float[np.ndarray, " dof"]:
        """Root mean square of τ_i for each drive."""
        return np.linalg.norm(self.factors[:, :, -1], axis=1) / np.sqrt(self.samples)


def gather(
    regressor: Regressor,
    log: Log,
    low_pass: LowPass | None,
    places: Places | None = None,
    load: Parameters | None = None,
) -> tuple[Information, ...]:
    """The information of one log, in consecutive blocks of equal length, read in constant memory.

    With a filter, the same filter goes over torques and regressor, and what remains is thinned to
    the rate that the cut-off allows. `merge` puts the blocks together; apart they tell how much
    results change from one stretch of the recording to the next. `places`, if given, takes in
    every sample as well.

    Friction that depends on load sees the torques that parameters `load` predict. Without them it
    sees the measured ones, whose noise then stands on both sides of the equation.

    Raises:
        IdentificationError: the regressor is not finite somewhere.
    """
    of_drive = _columns_of_drives(regressor)
    rows = regressor.regressor_pattern[0]

    def chunks(values: np.ndarray, tau: np.ndarray) -> list[Chunk]:
        return [(at, np.vstack([values[rows == i], tau[i]])) for i, at in enumerate(of_drive)]

    samples = _samples(regressor, log, low_pass, places, chunks, load)
    return tuple(
        _factorise(regressor, block, str(log.path)) for block in _blocks(samples, log, low_pass)
    )


def gather_samples(
    regressor: Regressor,
    z: Float[np.ndarray, "samples dof"],
    qd: Float[np.ndarray, "samples dof"],
    qdd: Float[np.ndarray, "samples dof"],
    tau: Float[np.ndarray, "samples dof"],
) -> Information:
    """The information of samples in memory."""
    pieces = (
        (regressor.sparse_regressor(z[part], qd[part], qdd[part], tau[part]).values, tau[part].T)
        for part in (slice(i, i + WINDOW) for i in range(0, len(z), WINDOW))
    )
    return _factorise(regressor, pieces, "samples")


def merge(parts: Iterable[Information]) -> Information:
    """Information of several recordings of the same robot together."""
    parts = tuple(parts)
    first = parts[0]
    factors = [
        triangle(np.vstack([part.factors[i] for part in parts])) for i in range(len(first.factors))
    ]
    return Information(
        columns=first.columns,
        factors=np.stack(factors),
        samples=sum(part.samples for part in parts),
        torque_max=np.max([part.torque_max for part in parts], axis=0),
    )


def whitened(
    regressor: Regressor,
    log: Log,
    low_pass: LowPass | None,
    whitening: Float[np.ndarray, "dof dof"],
    places: Places | None = None,
) -> tuple[Float[np.ndarray, "rank augmented"], ...]:
    """Factors of W^½ [Ȳ, τ̄] with W = Σ⁻¹ full over the drives of a sample; `whitening` is Σ^-½.

    One factor a block, as in `gather`. A second pass over the log, because rows of different drives
    are mixed.
    """
    columns = active_columns(regressor)
    rows, entries = regressor.regressor_pattern
    position = {column: k for k, column in enumerate(columns)}
    where = np.array([position[c] for c in entries])
    everything = np.arange(len(columns) + 1)

    def mixed(values: np.ndarray, tau: np.ndarray) -> Float[np.ndarray, "dof augmented samples"]:
        full = np.zeros((regressor.dof, len(everything), values.shape[1]))
        full[rows, where] = values
        full[:, -1] = tau
        return np.einsum("ij,jks->iks", whitening, full)

    def chunks(values: np.ndarray, tau: np.ndarray) -> list[Chunk]:
        return [(everything, drive) for drive in mixed(values, tau)]

    factors = []
    for block in _blocks(_samples(regressor, log, low_pass, places, chunks), log, low_pass):
        factor = np.zeros((0, len(everything)))
        for values, tau in block:
            factor = _chunk_triangle(np.hstack([factor.T, *mixed(values, tau)]))
        factors.append(factor)
    return tuple(factors)


def places_of(regressor: Regressor, logs: Iterable[Log]) -> Places:
    """Empty places over the range that recordings cover together."""
    return Places(logs, regressor.dof, len(active_columns(regressor)) + 1)


def active_columns(regressor: Regressor) -> Int[np.ndarray, " columns"]:
    """Parameters whose column of Y is not zero by structure, in the order of p."""
    return np.unique(regressor.regressor_pattern[1])


def _columns_of_drives(regressor: Regressor) -> list[Int[np.ndarray, " rows"]]:
    """For each drive, which columns of [Y, τ] its nonzero entries and its torque stand in."""
    columns = active_columns(regressor)
    rows, entries = regressor.regressor_pattern
    return [
        np.append(np.searchsorted(columns, entries[rows == i]), len(columns))
        for i in range(regressor.dof)
    ]


def _samples(
    regressor: Regressor,
    log: Log,
    low_pass: LowPass | None,
    places: Places | None,
    chunks: Callable[[np.ndarray, np.ndarray], Iterable[Chunk]],
    load: Parameters | None = None,
) -> Iterator[_Piece]:
    """Nonzero regressor entries and torques, both filtered and thinned alike, window by window."""
    for window in windows(log, regressor.kinematics, low_pass):
        motion = (window.z, window.qd, window.qdd)
        seen = window.tau if load is None else regressor.torque(*motion, load)
        values, tau, z = regressor.sparse_regressor(*motion, seen).values, window.tau.T, window.z
        if low_pass is not None:
            values = apply(low_pass.smooth, values, low_pass.decimation)
            tau = apply(low_pass.smooth, tau, low_pass.decimation)
            half = len(low_pass.smooth) // 2
            z = z[half : len(z) - half : low_pass.decimation]
        if places is not None:
            places.add(z, chunks(values, tau))
        yield values, tau


def _blocks(
    samples: Iterator[_Piece], log: Log, low_pass: LowPass | None
) -> Iterator[Iterator[_Piece]]:
    """The samples of each block of a log, all blocks of equal length but the last."""
    lost, thinned = (len(low_pass.first), low_pass.decimation) if low_pass else (0, 1)
    length = max(1, -(-(log.samples - lost) // (thinned * BLOCKS)))
    for _, block in groupby(_numbered(samples, length), key=lambda numbered: numbered[0]):
        yield (piece for _, piece in block)


def _numbered(pieces: Iterable[_Piece], length: int) -> Iterator[tuple[int, _Piece]]:
    """The same samples with the number of their block, cut where blocks of `length` end."""
    done = 0
    for values, tau in pieces:
        start, end = 0, tau.shape[1]
        while start < end:
            number, inside = divmod(done, length)
            part = slice(start, min(end, start + length - inside))
            yield number, (values[:, part], tau[:, part])
            done += part.stop - start
            start = part.stop


def _factorise(
    regressor: Regressor,
    pieces: Iterable[_Piece],
    where: str,
) -> Information:
    columns, of_drive = active_columns(regressor), _columns_of_drives(regressor)
    rows = regressor.regressor_pattern[0]
    n, dof = len(columns), regressor.dof
    factors = np.zeros((dof, n + 1, n + 1))
    samples, torque_max = 0, np.zeros(dof)
    for values, tau in pieces:
        for i in range(dof):
            chunk = np.vstack([values[rows == i], tau[i]])
            widened = np.zeros((chunk.shape[0], n + 1))
            R = _chunk_triangle(chunk)
            widened[: len(R), of_drive[i]] = R
            factors[i] = triangle(np.vstack([factors[i], widened]))
        samples += tau.shape[1]
        torque_max = np.maximum(torque_max, np.abs(tau).max(axis=1, initial=0.0))
    if not np.all(np.isfinite(factors)):
        raise IdentificationError(
            "the regressor is not finite; is the motion singular?", where=where
        )
    return Information(columns, factors, samples, torque_max)


def triangle(A: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, "rank n"]:
    """The upper triangular R with RᵀR = AᵀA, from a QR factorisation."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def _chunk_triangle(chunk: Float[np.ndarray, "n samples"]) -> Float[np.ndarray, "rows n"]:
    """The same for chunkᵀ, piece by piece, each with the triangle of those before on top."""
    n, samples = chunk.shape
    step = max(_PANEL // n - n, n)
    R = np.zeros((0, n))
    for start in range(0, samples, step):
        piece = np.hstack([R.T, chunk[:, start : start + step]])
        qr, _, _, _ = lapack.dgeqrf(piece.T, overwrite_a=1)  # in place: no copy in either order
        R = np.triu(qr[:n])
    return R
