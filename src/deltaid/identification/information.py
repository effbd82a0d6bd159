"""Everything a fit needs from any number of samples: triangular factors of [Ȳ, τ̄], one a drive.

For drive i let A_i = [Y_i, τ_i] hold its rows of all samples. Its QR factor R_i with
R_iᵀ R_i = A_iᵀ A_i is all that least squares, (15) and the torque error of any p ever use. Factors
of chunks stack and factor again (tall-skinny QR), so memory stays constant, results add up over
chunks, logs and machines, and no digits are lost to normal equations.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.errors import IdentificationError
from deltaid.recording.filter import LowPass, apply
from deltaid.recording.log import Log
from deltaid.recording.windows import WINDOW, Window, windows

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


def gather(dynamics: Dynamics, log: Log, low_pass: LowPass | None) -> tuple[Information, ...]:
    """The information of one log, in consecutive blocks of equal length, read in constant memory.

    With a filter, the same filter goes over torques and regressor, and what remains is thinned to
    the rate that the cut-off allows. `merge` puts the blocks together; apart they tell how much
    results change from one stretch of the recording to the next.

    Raises:
        IdentificationError: the regressor is not finite somewhere.
    """
    samples = (
        _evaluated(dynamics, w, low_pass) for w in windows(log, dynamics.kinematics, low_pass)
    )
    lost, thinned = (len(low_pass.first), low_pass.decimation) if low_pass else (0, 1)
    length = max(1, -(-(log.samples - lost) // (thinned * BLOCKS)))
    return tuple(
        _factorise(dynamics, (piece for _, piece in block), str(log.path))
        for _, block in groupby(_numbered(samples, length), key=lambda numbered: numbered[0])
    )


def gather_samples(
    dynamics: Dynamics,
    z: Float[np.ndarray, "samples dof"],
    qd: Float[np.ndarray, "samples dof"],
    qdd: Float[np.ndarray, "samples dof"],
    tau: Float[np.ndarray, "samples dof"],
) -> Information:
    """The information of samples in memory."""
    pieces = (
        (dynamics.sparse_regressor(z[part], qd[part], qdd[part], tau[part]).values, tau[part].T)
        for part in (slice(i, i + WINDOW) for i in range(0, len(z), WINDOW))
    )
    return _factorise(dynamics, pieces, "samples")


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
    dynamics: Dynamics,
    log: Log,
    low_pass: LowPass | None,
    whitening: Float[np.ndarray, "dof dof"],
) -> Float[np.ndarray, "augmented augmented"]:
    """Factor of W^½ [Ȳ, τ̄] with W = Σ⁻¹ full over the drives of a sample; `whitening` is Σ^-½.

    A second pass over the log, because rows of different drives are mixed.
    """
    columns = active_columns(dynamics)
    rows, entries = dynamics.regressor_pattern
    position = {column: k for k, column in enumerate(columns)}
    where = np.array([position[c] for c in entries])
    factor = np.zeros((0, len(columns) + 1))
    for window in windows(log, dynamics.kinematics, low_pass):
        values, tau = _evaluated(dynamics, window, low_pass)
        full = np.zeros((dynamics.dof, len(columns) + 1, values.shape[1]))
        full[rows, where] = values
        full[:, -1] = tau
        mixed = np.einsum("ij,jks->kis", whitening, full).reshape(len(columns) + 1, -1)
        factor = _chunk_triangle(np.hstack([factor.T, mixed]))
    return factor


def active_columns(dynamics: Dynamics) -> Int[np.ndarray, " columns"]:
    """Parameters whose column of Y is not zero by structure, in the order of p."""
    return np.unique(dynamics.regressor_pattern[1])


def _evaluated(dynamics: Dynamics, window: Window, low_pass: LowPass | None) -> _Piece:
    """Nonzero regressor entries and torques of a window, both filtered and thinned alike."""
    values = dynamics.sparse_regressor(window.z, window.qd, window.qdd, window.tau).values
    tau = window.tau.T
    if low_pass is None:
        return values, tau
    return tuple(apply(low_pass.smooth, x, low_pass.decimation) for x in (values, tau))  # pyright: ignore[reportReturnType]


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
    dynamics: Dynamics,
    pieces: Iterable[_Piece],
    where: str,
) -> Information:
    columns = active_columns(dynamics)
    rows, entries = dynamics.regressor_pattern
    n, dof = len(columns), dynamics.dof
    of_drive = [np.searchsorted(columns, entries[rows == i]) for i in range(dof)]
    factors = np.zeros((dof, n + 1, n + 1))
    samples, torque_max = 0, np.zeros(dof)
    for values, tau in pieces:
        for i in range(dof):
            chunk = np.vstack([values[rows == i], tau[i]])
            widened = np.zeros((chunk.shape[0], n + 1))
            R = _chunk_triangle(chunk)
            widened[: len(R), np.append(of_drive[i], n)] = R
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
