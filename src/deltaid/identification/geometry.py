"""What a robot's tolerances do to identified parameters, by linearisation.

A machine whose lengths, zeros and mounting are off by δg has torques D δg that the description does
not know of, D = dτ/dg (`dynamics.geometry`). Least squares takes them for

    δp_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW D δg

and the fit with a prior as much of these as of everything else that the data says. D is evaluated
at the fitted parameters, at some samples spread over the beginning of the recordings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import geometric_errors
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.additions import Addition, Extended, extended
from deltaid.identification.base_parameters import BaseParameters
from deltaid.identification.gathering import thinned
from deltaid.identification.information import Information, active_columns
from deltaid.identification.regularizer import parameter_scale
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Window
from deltaid.robot.tolerances import Tolerances

# Of each recording at most so many windows and seconds of its beginning, and of these so many
# samples.
_WINDOWS, _SECONDS, _SAMPLES = 32, 40.0, 1500
# Weight of all information beside that of these samples, which may show less.
_BESIDE = 1e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """What each geometric quantity that may be off does to base parameters.

    Attributes:
        names: of the quantities.
        shifts: of the least-squares base parameters by one standard deviation of each.
    """

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


def geometry(
    dynamics: Dynamics,
    recordings: Sequence[Recording],
    base: BaseParameters,
    information: Information,
    p: Parameters,
    additions: Sequence[Addition] = (),
) -> Geometry:
    """What the tolerances of a robot's description do to base parameters from recordings.

    Args:
        dynamics: of the robot.
        recordings: that the information comes from.
        base: base parameters, those of additions included.
        information: of all recordings.
        p: parameters of the robot.
        additions: what torques were explained with beside the robot.
    """
    if dynamics.robot.tolerances.exact:
        return Geometry((), np.zeros((base.rank, 0)))
    weights, regressor = np.sqrt(information.drive_weights), extended(dynamics, additions)
    active = information.columns
    rows = [
        geometric_rows(regressor, dynamics, one, p, weights, active=active) for one in recordings
    ]
    columns = [group.representative for group in base.groups]
    at = np.searchsorted(information.columns, columns)
    Y, D = (np.vstack(part) for part in zip(*((one.Y, one.D) for one in rows), strict=True))
    Y, whole = Y[:, at], information.weighted()[:, at]
    norms = np.linalg.norm(whole, axis=0)
    share = np.sqrt(_BESIDE) * np.linalg.norm(Y / norms) / np.sqrt(base.rank)
    shifts, *_ = np.linalg.lstsq(
        np.vstack([Y, share * whole]) / norms,
        np.vstack([D, np.zeros((len(whole), D.shape[1]))]),
        rcond=None,
    )
    return Geometry(rows[0].names, shifts / norms[:, None])


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
    rows, columns = regressor.regressor_pattern
    active, dof = active_columns(regressor) if active is None else active, dynamics.dof
    parts = []
    for window in _beginning(recording, dynamics):
        values, tau, _ = thinned(regressor, recording, window, p)
        own = window.own.part(slice(None, None, window.thinned))
        m = window.filtered(lambda w: w.weighted(np.ones_like(w.tau.T), np.arange(dof)))
        parts.append((values, tau, own.z.T, own.qd.T, own.qdd.T, m))
    values, tau, z, qd, qdd, m = (np.hstack(part) for part in zip(*parts, strict=True))
    every = slice(None, None, -(-values.shape[1] // _SAMPLES))
    errors = geometric_errors(dynamics, z.T[every], qd.T[every], qdd.T[every], p, tolerances)
    Y = np.zeros((dof, values[:, every].shape[1], len(active)))
    Y[rows, :, np.searchsorted(active, columns)] = values[:, every]
    D = [weights[:, None] * m[:, every] * one.torques for one in errors]
    return GeometricRows(
        (weights[:, None, None] * Y).reshape(-1, len(active)),
        (weights[:, None] * tau[:, every]).ravel(),
        np.reshape(D, (len(D), dof * Y.shape[1])).T,
        tuple(one.name for one in errors),
    )


def _beginning(recording: Recording, dynamics: Dynamics) -> Iterator[Window]:
    """The first windows of a recording."""
    most = _SECONDS * recording.log.rate
    for window in islice(recording.brief.windows(dynamics.kinematics), _WINDOWS):
        yield window
        if window.start + len(window.own.time) > most:
            return


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
