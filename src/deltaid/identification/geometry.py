"""What a robot's tolerances do to identified parameters, by linearisation.

A machine whose lengths, zeros and mounting are off by δg has torques D δg that the description does
not know of, D = dτ/dg (`dynamics.geometry`). Least squares takes them for

    δp_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW D δg

and the fit with a prior as much of these as of all other data. D is evaluated
at the fitted parameters, at some samples spread over the beginning of the recordings.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import Error, geometric_errors
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.additions import Addition, Extended, extended
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import Information, active_columns
from deltaid.estimation.regularizer import parameter_scale
from deltaid.estimation.span import lengths
from deltaid.identification.gathering import thinned
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Window
from deltaid.robot.tolerances import Tolerances
from deltaid.sensors.geometry import sensor_errors

# Of each recording at most so many windows and seconds of its beginning, and of these so many
# samples.
_WINDOWS, _SECONDS, _SAMPLES = 32, 40.0, 1500
# Weight of all information relative to these samples, which may determine less.
_BESIDE = 1e-3
# Some quantities, each over the samples of a window.
_OfWindow = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Quantities that may be off, and what one standard deviation of each shifts least-squares
    base parameters by."""

    names: tuple[str, ...]
    shifts: Float[np.ndarray, "base quantities"]

    def beside(self, base: BaseParameters, moves: Sequence[Mapping[str, float]]) -> "Geometry":
        """With other causes, of which each moves parameters, by name, by one standard deviation."""
        names = base.layout.names
        parameters = np.array([[move.get(name, 0.0) for name in names] for move in moves])
        shifts = base.combination() @ parameters.reshape(-1, len(names)).T
        causes = tuple(f"cause {k + 1}" for k in range(len(moves)))
        return Geometry((*self.names, *causes), np.hstack([self.shifts, shifts]))


@dataclass(frozen=True, eq=False)
class GeometricRows:
    """Some filtered samples, those of one drive after those of the other.

    Attributes:
        Y: active columns, weighted as in the fit.
        tau: measured torques, weighted alike.
        D: what torques one standard deviation of each quantity makes, weighted alike.
        names: of the quantities.
    """

    Y: Float[np.ndarray, "rows columns"]
    tau: Float[np.ndarray, " rows"]
    D: Float[np.ndarray, "rows quantities"]
    names: tuple[str, ...]

    def over(self, names: Sequence[str]) -> Float[np.ndarray, "rows named"]:
        """D for more quantities; those that do nothing here are zero."""
        known, nothing = dict(zip(self.names, self.D.T, strict=True)), np.zeros(len(self.tau))
        effects = [known.get(name, nothing) for name in names]
        return np.reshape(effects, (len(names), len(self.tau))).T


def geometry(
    dynamics: Dynamics,
    recordings: Sequence[Recording],
    base: BaseParameters,
    information: Information,
    values: Float[np.ndarray, " parameters"],
    additions: Sequence[Addition] = (),
) -> Geometry:
    """What the tolerances of a robot's description do to base parameters from recordings.

    Args:
        base: base parameters, those of additions included.
        information: of all recordings.
        values: parameters of the robot, and of the additions behind them.
    """
    if dynamics.robot.tolerances.exact:
        return Geometry((), np.zeros((base.rank, 0)))
    regressor, active = extended(dynamics, additions), information.columns
    drives, sensors = np.split(np.sqrt(information.weights), [information.drives.stop])
    measured, p, rows = MeasuredRows(regressor), values[: len(dynamics.layout.names)], []
    for recording in recordings:
        rows.append(geometric_rows(regressor, dynamics, recording, p, drives, active=active))
        rows += _sensor_rows(measured, dynamics, recording, values, sensors, active)
    return shifted(rows, base, information, additions)


def shifted(
    rows: Sequence[GeometricRows],
    base: BaseParameters,
    information: Information,
    additions: Sequence[Addition] = (),
) -> Geometry:
    """Shifts of base parameters by what quantities do to some rows, as of `geometry`."""
    active = information.columns
    determined = tuple(start for addition in additions for start in addition.tells)
    all_names = dict.fromkeys(name for row in rows for name in row.names)
    names = tuple(name for name in all_names if not (determined and name.startswith(determined)))
    k = np.searchsorted(active, [group.representative for group in base.groups])
    Y, D = np.vstack([row.Y for row in rows])[:, k], np.vstack([row.over(names) for row in rows])
    total = replace(information, facts=None).weighted()[:, k]
    norms = lengths(total)  # 1 for those that measured values alone determine
    share = np.linalg.norm(Y / norms) / np.sqrt(base.rank)
    # Measured values are of the machine as it is, so they constrain a shift as well.
    facts = np.zeros((0, len(k))) if information.facts is None else information.facts[:, k]
    extra = share / norms * np.vstack([np.sqrt(_BESIDE) * total, facts])
    D = np.vstack([D, np.zeros((len(extra), len(names)))])
    shifts, *_ = np.linalg.lstsq(np.vstack([Y / norms, extra]), D, rcond=None)
    return Geometry(names, shifts / norms[:, None])


def _sensor_rows(
    measured: MeasuredRows,
    dynamics: Dynamics,
    recording: Recording,
    values: Float[np.ndarray, " parameters"],
    weights: Float[np.ndarray, " channels"],
    active: Int[np.ndarray, " columns"],
) -> Iterator[GeometricRows]:
    """The same samples as sensors show them, one after the other, as `geometric_rows` has torques.

    Args:
        values: all fitted parameters, those of additions behind the robot's.
        weights: of the channels of all sensors.
    """
    if not measured.sensors:
        return

    def of(window: Window) -> _OfWindow:
        sensed = measured.shown(window, recording)
        assert sensed is not None
        return sensed.values, sensed.y, sensed.counted

    (entries, y, counted), (z, qd, qdd) = _beginning(recording, dynamics, of)
    rows, columns = measured.regressor_pattern
    of_sensors, first = rows >= measured.drives, 0
    rows, columns = rows[of_sensors] - measured.drives, columns[of_sensors]
    p = values[: len(dynamics.layout.names)]
    for part in measured.sensors:
        channels = np.arange(first, first + part.channels)
        mine = np.isin(rows, channels)
        errors = sensor_errors(part.graph, z, qd, qdd, np.append(p, part.unknowns(values)))
        places, counts = (rows[mine] - first, columns[mine]), np.sqrt(counted[channels])
        yield _rows(weights[channels], entries[mine], places, y[channels], counts, errors, active)
        first += part.channels


def geometric_rows(
    regressor: Dynamics | Extended,
    dynamics: Dynamics,
    recording: Recording,
    p: Parameters,
    weights: Float[np.ndarray, " dof"],
    tolerances: Tolerances | None = None,
    active: Int[np.ndarray, " columns"] | None = None,
) -> GeometricRows:
    """Samples spread evenly over the beginning of a recording, and the effects of
    tolerances on torques there, by default of the description's;
    with the columns of torques, or `active`."""
    drives = np.arange(dynamics.dof)

    def of(window: Window) -> _OfWindow:
        values, tau, _ = thinned(regressor, recording, window, p)
        counts = window.filtered(lambda w: w.weighted(np.ones_like(w.tau.T), drives))
        return values, tau, counts

    (values, tau, counts), (z, qd, qdd) = _beginning(recording, dynamics, of)
    errors = geometric_errors(dynamics, z, qd, qdd, p, tolerances)
    active = active_columns(regressor) if active is None else active
    return _rows(weights, values, regressor.regressor_pattern, tau, counts, errors, active)


def _rows(
    weights: Float[np.ndarray, " channels"],
    entries: Float[np.ndarray, "entries samples"],
    places: tuple[np.ndarray, np.ndarray],
    y: Float[np.ndarray, "channels samples"],
    counts: Float[np.ndarray, "channels samples"],
    errors: Sequence[Error],
    active: Int[np.ndarray, " columns"],
) -> GeometricRows:
    """Rows of channels with entries of the regressor `at` channel and column, and what counts."""
    Y = np.zeros((*y.shape, len(active)))
    Y[places[0], :, np.searchsorted(active, places[1])] = entries
    w = weights[:, None]
    D = [w * counts * error.effect for error in errors]
    return GeometricRows(
        (w[:, :, None] * Y).reshape(-1, len(active)),
        (w * y).ravel(),
        np.reshape(D, (len(D), y.size)).T,
        tuple(error.name for error in errors),
    )


def _beginning(
    recording: Recording, dynamics: Dynamics, values_of: Callable[[Window], _OfWindow]
) -> tuple[_OfWindow, _OfWindow]:
    """What the first windows of a recording give, at samples spread evenly, and z, q̇, q̈ there."""
    most, parts = _SECONDS * recording.log.rate, []
    for window in islice(recording.brief.windows(dynamics.kinematics), _WINDOWS):
        samples = window.own.part(slice(None, None, window.thinned))
        parts.append((*values_of(window), samples.z.T, samples.qd.T, samples.qdd.T))
        if window.start + len(window.own.time) > most:
            break
    joined = [np.hstack(part) for part in zip(*parts, strict=True)]
    sparse = slice(None, None, -(-joined[0].shape[1] // _SAMPLES))
    a, b, c, z, qd, qdd = (part[:, sparse] for part in joined)
    return (a, b, c), (z.T, qd.T, qdd.T)


def nearest(
    dynamics: Dynamics, base: BaseParameters, values: Float[np.ndarray, " base"]
) -> Parameters:
    """The parameters nearest to the prior, by its sizes, that have some base parameters.

    p = p_reg + S² Kᵀ (K S² Kᵀ)⁻¹ (p_B − K p_reg), S the prior's sizes.
    """
    prior = prior_parameters(dynamics.robot)
    S = np.diag(parameter_scale(dynamics.layout, prior))
    K = base.combination()
    return prior + S @ np.linalg.lstsq(K @ S, values - K @ prior, rcond=None)[0]
