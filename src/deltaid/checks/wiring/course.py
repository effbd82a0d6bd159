"""The torques of a whole recording: as recorded, and as fits that trust most of its rows have
them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.checks.wiring.residual import LEAST, Map, MapResidual, motion, residual
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.problem import lengths
from deltaid.levels import NEGLIGIBLE

# Most rows that are compared; of a longer recording, rows are skipped.
_MOST = 20_000
# Rounds of the fit.
_ROUNDS = 10
# Largest share of what is unexplained that may remain with a lag, a sign or another order.
CLEARER = 0.5

TINY = np.finfo(float).tiny

Torques = Float[np.ndarray, "moving samples"]
OfDrives = Float[np.ndarray, " moving"]


@dataclass(frozen=True, eq=False)
class TorqueCourse:
    """Torques of moving drives over time: recorded, and by the prior, a fit, and a fit to recorded
    magnitudes; the last three are zero where unknown.

    Attributes:
        regressor: rows of Y; zero where torques are unknown.
        fine: recorded torques, `every` times as often as samples; sample k is at `first` + k every.
        one_sided: whether all recorded torques of a drive have the same sign.
        blurred: samples on either side that the filter mixes with one.
    """

    drives: Int[np.ndarray, " moving"]
    time: Float[np.ndarray, " samples"]
    regressor: ColumnsOfDrives
    prior: Torques
    fitted: Torques
    unsigned: Torques
    recorded: Torques
    fine: Float[np.ndarray, "moving fine"]
    first: int
    every: int
    one_sided: Bool[np.ndarray, " moving"]
    blurred: int

    @property
    def step(self) -> float:
        return float(self.time[1] - self.time[0])

    @classmethod
    def from_recording(cls, log: RemappedRecording) -> "TorqueCourse | None":
        """The whole recording, as it is mapped; None where its loops do not close."""
        rows, moved, dynamics = log.evidence.on_time, log.motion, log.evidence.dynamics
        skipped, whole = -(-len(rows.time) // _MOST), float(np.ptp(rows.time))
        if moved.time[-1] - moved.time[0] < 0.9 * whole:
            fewer = {name: values[::skipped] for name, values in vars(rows).items()}
            moved = motion(replace(rows, **fewer), longest=whole) or moved
        under = residual(dynamics, moved, Map.identity(dynamics.dof))
        if under is None:
            return None
        one_sided = np.all(rows.tau >= 0, axis=0) | np.all(rows.tau <= 0, axis=0)
        fit = _of_most_rows(under, np.zeros_like(one_sided))
        known = under.prior, fit, _of_most_rows(under, one_sided) if one_sided.any() else fit
        drives, regressor = np.flatnonzero(~under.still), under.regressor
        prior, fitted, unsigned = (regressor[drives] @ p for p in known)
        half, every = moved.low_pass.half, moved.low_pass.decimation
        return cls(
            drives=drives,
            time=moved.time,
            regressor=regressor[drives],
            prior=prior,
            fitted=fitted,
            unsigned=unsigned,
            recorded=moved.tau.T[drives],
            fine=moved.load.T[drives],
            first=half,
            every=every,
            one_sided=one_sided[drives],
            blurred=half // (2 * every),
        )


def _of_most_rows(
    under: MapResidual, unsigned: Bool[np.ndarray, " drives"]
) -> Float[np.ndarray, " columns"]:
    """Parameters that fit the larger part of the rows: for errors with a Cauchy distribution scaled
    by their median, starting at the prior. Torques of `unsigned` drives get the model's sign."""
    tau, p, scale = under.rows.stack(under.tau.T), under.prior, lengths(under.Y)
    turned = np.repeat(unsigned, len(tau) // len(unsigned))
    for _ in range(_ROUNDS):
        predicted = under.Y @ p
        tau = np.where(turned, np.copysign(tau, predicted), tau)
        errors = np.abs(tau - predicted)
        weights = 1.0 / np.hypot(1.0, errors / max(float(np.median(errors)), LEAST))
        A = weights[:, None] * under.Y / scale
        p = np.linalg.lstsq(A, weights * tau, rcond=NEGLIGIBLE)[0] / scale
    return p


def gains(f: Torques, u: Torques) -> tuple[OfDrives, OfDrives]:
    """Factors of torques f that fit u best, and their correlations."""
    fu, ff, uu = (np.sum(product, axis=1) for product in (f * u, f**2, u**2))
    return fu / np.maximum(ff, TINY), fu / np.sqrt(np.maximum(ff * uu, TINY))
