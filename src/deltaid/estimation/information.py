"""The information of any number of samples: triangular factors of [Ȳ, τ̄], one a drive, then one a
channel of sensors.

Let A_i = [Y_i, τ_i] have the rows of drive i of all samples. Least squares, (15) and the torque
error of any p need only its QR factor R_i with R_iᵀ R_i = A_iᵀ A_i. Factors of chunks are stacked
and factored again (tall-skinny QR), so memory stays constant, results add up over chunks, logs and
machines, and no digits are lost to normal equations.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.problem import LinearProblem

# Entries of a matrix that is factored at once, so that it stays in the cache.
_PANEL = 60_000


@runtime_checkable
class ExplainingColumns(Protocol):
    """Columns that explain torques, drive by drive, as those of `Dynamics` do."""

    @property
    def dof(self) -> int: ...  # of drives and channels of sensors

    @property
    def regressor_pattern(self) -> tuple[np.ndarray, np.ndarray]: ...


# Columns of [Y, τ] and their samples in rows.
Chunk = tuple[Int[np.ndarray, " _"], Float[np.ndarray, "_ samples"]]
PerRow = Float[np.ndarray, " rows"]
OfDrives = Float[np.ndarray, "dof samples"]
Motion = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True)
class Information:
    """Information on the parameters in a recording."""

    columns: Int[np.ndarray, " columns"]  # numbers in p of the factors' columns
    # for each drive, then for each channel of sensors, F with FᵀF = [Y_i, τ_i]ᵀ[Y_i, τ_i]
    factors: Float[np.ndarray, "rows augmented augmented"]
    # number of each; a sample counts for the part of its noise that a recording's weights leave
    samples: PerRow
    torque_max: PerRow  # largest |τ| of each
    channels: int = 0  # number of the last factors that are of sensors
    # scale of each channel, in which its noise is σ̂ (`gathering.balanced`); None before
    levels: Float[np.ndarray, " channels"] | None = None
    # rows [c, v] of measured values, cᵀp = v, scaled to the noise σ̂
    facts: Float[np.ndarray, "facts augmented"] | None = None

    @property
    def drives(self) -> slice:
        return slice(0, len(self.factors) - self.channels)

    @property
    def of_drives(self) -> "Information":
        own = self.drives
        return Information(self.columns, self.factors[own], self.samples[own], self.torque_max[own])

    @property
    def rows(self) -> float:
        return float(self.samples.sum()) + (0 if self.facts is None else len(self.facts))

    @property
    def mean_samples(self) -> float:
        """s, the mean number of samples over the drives."""
        return float(self.samples[self.drives].mean())

    @property
    def weights(self) -> PerRow:
        """W_τ = diag(τ_max)⁻², 0 for a drive without torques, then those of channels of sensors by
        their levels."""
        sizes, used = self.torque_max.copy(), self.torque_max > 0
        if self.levels is not None:
            sizes[self.drives.stop :] = self.levels
        return np.where(used, np.where(used, sizes, 1.0) ** -2.0, 0.0)

    def weighted(self, weights: PerRow | None = None) -> Float[np.ndarray, "augmented augmented"]:
        """Factor of W^½ [Ȳ, τ̄] with one weight a drive or channel. With the fit's weights, the
        default, facts are included."""
        facts = self.facts if weights is None else None
        scaled = self.factors * np.sqrt(self.weights if weights is None else weights)[:, None, None]
        rows = scaled.reshape(-1, scaled.shape[2])
        return triangle(rows if facts is None else np.vstack([rows, facts]))

    @property
    def problem(self) -> LinearProblem:
        """Least squares of all rows with the fit's weights."""
        return LinearProblem.of_triangle(self.weighted(), self.rows)

    def problem_of(self, i: int) -> LinearProblem:
        """Least squares of one drive or channel alone, in its own unit."""
        return LinearProblem.of_triangle(self.factors[i], float(self.samples[i]))

    def rms(self, p: Parameters) -> PerRow:
        """Root mean square of τ_i − Y_i p for each drive and channel; 0 without samples."""
        residual = self.factors @ np.append(-p[self.columns], 1.0)
        return np.linalg.norm(residual, axis=1) / np.sqrt(np.maximum(self.samples, 1.0))

    def torque_rms(self) -> Float[np.ndarray, " dof"]:
        return np.linalg.norm(self.factors[:, :, -1], axis=1) / np.sqrt(self.samples)


@dataclass(frozen=True, eq=False)
class Condensed:
    """Some samples as triangles, one of each chunk (a drive's rows of [Y, τ]) with its columns;
    samples and torque_max as of `Information`."""

    triangles: tuple[tuple[Int[np.ndarray, " _"], Float[np.ndarray, "_ _"]], ...]
    samples: Float[np.ndarray, " dof"]
    torque_max: Float[np.ndarray, " dof"]


def condense(chunks: Iterable[Chunk], tau: OfDrives, counted: OfDrives) -> Condensed:
    """Triangles of some samples' chunks, factored piece by piece; `counted` is the part that each
    sample counts for."""
    triangles = []
    for columns, rows in chunks:
        n, samples = rows.shape
        step, R = max(_PANEL // n - n, n), np.zeros((0, n))
        for start in range(0, samples, step):
            R = triangle(np.vstack([R, rows[:, start : start + step].T]))
        triangles.append((columns, R))
    return Condensed(tuple(triangles), counted.sum(axis=1), np.abs(tau).max(axis=1, initial=0.0))


def collect(
    regressor: ExplainingColumns, parts: Iterable[Condensed], where: str, channels: int = 0
) -> Information:
    """The information of condensed samples, added up in order; `channels` as of `Information`.

    Raises:
        IdentificationError: the regressor is not finite somewhere in `where`.
    """
    columns, dof = active_columns(regressor), regressor.dof
    n = len(columns) + 1
    factors, samples, torque_max = np.zeros((dof, n, n)), np.zeros(dof), np.zeros(dof)
    for part in parts:
        for i, (places, R) in enumerate(part.triangles):
            widened = np.zeros((len(R), n))
            widened[:, places] = R
            factors[i] = triangle(np.vstack([factors[i], widened]))
        samples = samples + part.samples
        torque_max = np.maximum(torque_max, part.torque_max)
    if not np.all(np.isfinite(factors)):
        raise IdentificationError(
            "the regressor is not finite; is the motion singular?",
            where=where,
            cure="exclude what comes near a singular pose, and check the robot's lengths",
        )
    return Information(columns, factors, samples, torque_max, channels)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def gather_samples(
    dynamics: Dynamics, z: Motion, qd: Motion, qdd: Motion, tau: Motion
) -> Information:
    """The information of samples in memory."""
    y = tau.T
    chunks = chunks_of_drives(dynamics, entries_at(dynamics, z, qd, qdd, tau), y)
    return collect(dynamics, [condense(chunks, y, np.ones_like(y))], "samples")


def merge(parts: Iterable[Information]) -> Information:
    parts = tuple(parts)
    factors = [triangle(np.vstack(R)) for R in zip(*(p.factors for p in parts), strict=True)]
    samples = np.sum([part.samples for part in parts], axis=0)
    torque_max = np.max([part.torque_max for part in parts], axis=0)
    return Information(parts[0].columns, np.stack(factors), samples, torque_max, parts[0].channels)


def active_columns(regressor: ExplainingColumns) -> Int[np.ndarray, " columns"]:
    """Parameters whose column of Y is not zero by structure, or that have measured values, in the
    order of p."""
    known = getattr(regressor, "known_columns", np.zeros(0, dtype=int))
    return np.unique(np.concatenate([regressor.regressor_pattern[1], known]))


def chunks_of_drives(
    regressor: ExplainingColumns, values: Float[np.ndarray, "entries samples"], y: OfDrives
) -> list[Chunk]:
    """Rows of [Y, τ] of each drive and channel, without the columns that are zero by structure."""
    columns, (rows, entries) = active_columns(regressor), regressor.regressor_pattern
    places = np.searchsorted(columns, entries)
    return [
        (np.append(places[rows == i], len(columns)), np.vstack([values[rows == i], y[i]]))
        for i in range(regressor.dof)
    ]


def triangle(A: Float[np.ndarray, "*many rows n"]) -> Float[np.ndarray, "*many rank n"]:
    """The upper triangular R with RᵀR = AᵀA, from a QR factorisation."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def entries_at(
    dynamics: Dynamics, z: Motion, qd: Motion, qdd: Motion, load: Motion | None = None
) -> Float[np.ndarray, "entries samples"]:
    """Entries of Y of a robot, in the order of its pattern; only this function evaluates them."""
    return dynamics.sparse_regressor(z, qd, qdd, load).values
