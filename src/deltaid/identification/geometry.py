"""What a robot's tolerances do to identified parameters, by linearisation.

A machine whose lengths, zeros and mounting are off by δg has torques D δg that the description does
not know of, D = dτ/dg (`dynamics.geometry`). Least squares takes them for

    δp_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW D δg

and the fit with a prior as much of these as of everything else that the data says. D is evaluated
at the fitted parameters, at some samples spread over the beginning of the recordings.
"""

from collections.abc import Callable, Iterator, Sequence
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
# Weight of all information beside that of these samples, which may show less.
_BESIDE = 1e-3
# Some quantities, each over the samples of a window.
_OfWindow = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Quantities that may be off, and what one standard deviation of each shifts least-squares
    base parameters by."""

    names: tuple[str, ...]
    shifts: Float[np.ndarray, "base quantities"]


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
        found = [known.get(name, nothing) for name in names]
        return np.reshape(found, (len(names), len(self.tau))).T


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
    seen, p, rows = MeasuredRows(regressor), values[: len(dynamics.layout.names)], []
    for recording in recordings:
        rows.append(geometric_rows(regressor, dynamics, recording, p, drives, active=active))
        rows += _sensor_rows(seen, dynamics, recording, values, sensors, active)
    return shifted(rows, base, information, additions)


def shifted(
    rows: Sequence[GeometricRows],
    base: BaseParameters,
    information: Information,
    additions: Sequence[Addition] = (),
) -> Geometry:
    """Shifts of base parameters by what quantities do to some rows, as of `geometry`."""
    active = information.columns
    told = tuple(start for one in additions for start in one.tells)
    every = dict.fromkeys(name for one in rows for name in one.names)
    names = tuple(name for name in every if not (told and name.startswith(told)))
    at = np.searchsorted(active, [group.representative for group in base.groups])
    Y, D = np.vstack([one.Y for one in rows])[:, at], np.vstack([one.over(names) for one in rows])
    whole = replace(information, facts=None).weighted()[:, at]
    norms = lengths(whole)  # 1 for those that measured values alone show
    share = np.linalg.norm(Y / norms) / np.sqrt(base.rank)
    # Measured values are of the machine as it is: they hold a shift as they hold the fit.
    facts = np.zeros((0, len(at))) if information.facts is None else information.facts[:, at]
    beside = share / norms * np.vstack([np.sqrt(_BESIDE) * whole, facts])
    D = np.vstack([D, np.zeros((len(beside), len(names)))])
    shifts, *_ = np.linalg.lstsq(np.vstack([Y / norms, beside]), D, rcond=None)
    return Geometry(names, shifts / norms[:, None])


def _sensor_rows(
    seen: MeasuredRows,
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
    if not seen.sensors:
        return

    def of(window: Window) -> _OfWindow:
        shown = seen.shown(window, recording)
        assert shown is not None
        return shown.values, shown.y, shown.counted

    (entries, y, counted), (z, qd, qdd) = _beginning(recording, dynamics, of)
    rows, columns = seen.regressor_pattern
    of_sensors, first = rows >= seen.drives, 0
    rows, columns = rows[of_sensors] - seen.drives, columns[of_sensors]
    p = values[: len(dynamics.layout.names)]
    for part in seen.sensors:
        channels = np.arange(first, first + part.channels)
        mine = np.isin(rows, channels)
        errors = sensor_errors(part.graph, z, qd, qdd, np.append(p, part.unknowns(values)))
        at, counts = (rows[mine] - first, columns[mine]), np.sqrt(counted[channels])
        yield _rows(weights[channels], entries[mine], at, y[channels], counts, errors, active)
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
    """Samples spread evenly over the beginning of a recording, and what tolerances, by default
    those of the description, do to torques there; with the columns of torques, or those given."""
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
    at: tuple[np.ndarray, np.ndarray],
    y: Float[np.ndarray, "channels samples"],
    counts: Float[np.ndarray, "channels samples"],
    errors: Sequence[Error],
    active: Int[np.ndarray, " columns"],
) -> GeometricRows:
    """Rows of channels with entries of the regressor `at` channel and column, and what counts."""
    Y = np.zeros((*y.shape, len(active)))
    Y[at[0], :, np.searchsorted(active, at[1])] = entries
    w = weights[:, None]
    D = [w * counts * error.effect for error in errors]
    return GeometricRows(
        (w[:, :, None] * Y).reshape(-1, len(active)),
        (w * y).ravel(),
        np.reshape(D, (len(D), y.size)).T,
        tuple(error.name for error in errors),
    )


def _beginning(
    recording: Recording, dynamics: Dynamics, of: Callable[[Window], _OfWindow]
) -> tuple[_OfWindow, _OfWindow]:
    """What the first windows of a recording give, at samples spread evenly, and z, q̇, q̈ there."""
    most, parts = _SECONDS * recording.log.rate, []
    for window in islice(recording.brief.windows(dynamics.kinematics), _WINDOWS):
        own = window.own.part(slice(None, None, window.thinned))
        parts.append((*of(window), own.z.T, own.qd.T, own.qdd.T))
        if window.start + len(window.own.time) > most:
            break
    found = [np.hstack(part) for part in zip(*parts, strict=True)]
    every = slice(None, None, -(-found[0].shape[1] // _SAMPLES))
    a, b, c, z, qd, qdd = (part[:, every] for part in found)
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
