"""Effects of geometric tolerances on identified parameters, by linearisation.

Lengths, zeros and mounting that are off by δg add torques D δg, D = dτ/dg (`dynamics.geometry`).
Least squares takes them for changes of the base parameters,

    δp_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW D δg.

D is evaluated at the fitted parameters, at samples spread over the beginning of the recordings.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import Error, geometric_errors
from deltaid.estimation.additions import Addition, Extended, extended
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import Information, active_columns
from deltaid.estimation.problem import lengths
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.recording.log import MOST_WINDOWS
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.body import NUMBERED
from deltaid.robot.tolerances import Tolerances
from deltaid.sensors.robot_sensors import sensor_errors

# Length of a recording's beginning that is used [s], and largest number of samples of it.
_SECONDS, _SAMPLES = 40.0, 1500
# Weight of a recording's information beside these samples, which may not determine everything.
_BESIDE = 1e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """Quantities that may be off, and shifts of base parameters by their standard deviations."""

    names: tuple[str, ...]
    shifts: Float[np.ndarray, "base quantities"]

    @classmethod
    def exact(cls, base: BaseParameters) -> "Geometry":
        """Nothing is off."""
        return cls((), np.zeros((base.rank, 0)))

    def with_causes(self, base: BaseParameters, moves: Sequence[Mapping[str, float]]) -> "Geometry":
        """With corrected causes, whose deviations change parameters by `moves`, by name; those of
        a shared body change each limb's own."""
        names = [(name, NUMBERED.sub(r"\1", name)) for name in base.layout.names]
        parameters = np.array(
            [[move.get(name, move.get(shared, 0.0)) for name, shared in names] for move in moves]
        )
        shifts = base.combination() @ parameters.reshape(-1, len(names)).T
        causes = tuple(f"cause {k + 1}" for k in range(len(moves)))
        return Geometry((*self.names, *causes), np.hstack([self.shifts, shifts]))


@dataclass(frozen=True, eq=False)
class GeometricRows:
    """Some filtered samples, drive by drive, weighted as in a fit."""

    Y: Float[np.ndarray, "rows columns"]  # active columns
    tau: Float[np.ndarray, " rows"]  # measured torques
    D: Float[np.ndarray, "rows quantities"]  # torques of one standard deviation of each quantity
    names: tuple[str, ...]  # of the quantities

    def over(self, names: Sequence[str]) -> Float[np.ndarray, "rows named"]:
        """D for quantities by name; zero for those without an effect here."""
        known, nothing = dict(zip(self.names, self.D.T, strict=True)), np.zeros(len(self.tau))
        effects = [known.get(name, nothing) for name in names]
        return np.reshape(effects, (len(names), len(self.tau))).T


def geometry(
    dynamics: Dynamics,
    recordings: Sequence[PreparedRecording],
    base: BaseParameters,
    information: Information,
    values: Float[np.ndarray, " parameters"],
    additions: Sequence[Addition] = (),
) -> Geometry:
    """Shifts of base parameters by the tolerances of a robot's description.

    Args:
        information: of the recordings.
        values: all fitted parameters, those of additions behind the robot's.
    """
    if dynamics.robot.tolerances.exact:
        return Geometry.exact(base)
    regressor, weights = extended(dynamics, additions), np.sqrt(information.weights)
    rows = [
        row
        for recording in recordings
        for row in geometric_rows(
            regressor, dynamics, recording, values, weights, active=information.columns
        )
    ]
    return shifted(rows, base, information, additions)


def shifted(
    rows: Sequence[GeometricRows],
    base: BaseParameters,
    information: Information,
    additions: Sequence[Addition] = (),
) -> Geometry:
    """Shifts of base parameters by the quantities of some rows."""
    active = information.columns
    determined = tuple(start for addition in additions for start in addition.determines)
    all_names = dict.fromkeys(name for row in rows for name in row.names)
    names = tuple(name for name in all_names if not (determined and name.startswith(determined)))
    k = np.searchsorted(active, [group.representative for group in base.groups])
    Y, D = np.vstack([row.Y for row in rows])[:, k], np.vstack([row.over(names) for row in rows])
    total = replace(information, facts=None).weighted()[:, k]
    norms = lengths(total)  # 1 for those that measured values alone determine
    share = np.linalg.norm(Y / norms) / np.sqrt(base.rank)
    # Measured values are those of the real machine, so they constrain shifts.
    facts = np.zeros((0, len(k))) if information.facts is None else information.facts[:, k]
    extra = share / norms * np.vstack([np.sqrt(_BESIDE) * total, facts])
    D = np.vstack([D, np.zeros((len(extra), len(names)))])
    shifts, *_ = np.linalg.lstsq(np.vstack([Y / norms, extra]), D, rcond=None)
    return Geometry(names, shifts / norms[:, None])


def geometric_rows(
    regressor: Extended,
    dynamics: Dynamics,
    recording: PreparedRecording,
    values: Float[np.ndarray, " parameters"],
    weights: Float[np.ndarray, " rows"],
    tolerances: Tolerances | None = None,
    active: Int[np.ndarray, " columns"] | None = None,
) -> Iterator[GeometricRows]:
    """Rows at samples spread evenly over the beginning of a recording: of torques, then of sensors.

    Args:
        values: all fitted parameters.
        weights: of drives, then of channels of sensors.
        tolerances: by default the description's.
        active: columns that are kept; by default those that torques depend on.
    """
    measured, p = MeasuredRows(regressor), values[: len(dynamics.layout.names)]
    entries, y, counts, motion = _beginning(measured, dynamics, recording, p)
    active = active_columns(regressor) if active is None else active
    places, columns = measured.regressor_pattern
    kept = np.isin(columns, active)
    Y = np.zeros((*y.shape, len(active)))
    Y[places[kept], :, np.searchsorted(active, columns[kept])] = entries[kept]

    def rows_of(own: slice, errors: Sequence[Error]) -> GeometricRows:
        w = weights[own, None]
        D = [w * counts[own] * error.effect for error in errors]
        return GeometricRows(
            (w[:, :, None] * Y[own]).reshape(-1, len(active)),
            (w * y[own]).ravel(),
            np.reshape(D, (len(D), y[own].size)).T,
            tuple(error.name for error in errors),
        )

    yield rows_of(slice(measured.drives), geometric_errors(dynamics, *motion, p, tolerances))
    for part in measured.sensors:
        rows = part.columns.rows
        own = values[part.first : part.first + len(rows.parameters)]
        yield rows_of(part.rows, sensor_errors(rows, *motion, np.append(p, own)))


def _beginning(
    measured: MeasuredRows, dynamics: Dynamics, recording: PreparedRecording, p: Parameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Entries, y, its weights, and z, q̇, q̈ at samples spread evenly over the first windows of a
    recording."""
    most, drives, parts = _SECONDS * recording.log.rate, np.arange(measured.drives), []
    for window in islice(recording.brief.windows(dynamics.kinematics), MOST_WINDOWS):
        rows, samples = measured.filtered(window, recording, p), window.inner
        counts = window.filtered(lambda w: w.weighted(np.ones_like(w.tau.T), drives))
        counts = np.vstack([counts, np.sqrt(rows.counted[measured.drives :])])
        motion = (x[:: window.low_pass.thinned].T for x in (samples.z, samples.qd, samples.qdd))
        parts.append((rows.entries, rows.y, counts, *motion))
        if window.start + len(samples.time) > most:
            break
    joined = [np.hstack(part) for part in zip(*parts, strict=True)]
    sparse = slice(None, None, -(-joined[0].shape[1] // _SAMPLES))
    entries, y, counts, z, qd, qdd = (part[:, sparse] for part in joined)
    return entries, y, counts, (z.T, qd.T, qdd.T)
