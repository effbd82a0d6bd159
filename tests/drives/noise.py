"""Errors that the noise of a recording causes in any identification."""

import numpy as np

from deltaid.dynamics.dynamics import compiled
from drives.errors import SPEEDS, half_range
from drives.rows import Case
from oracle.tree import Array
from support import largest_mass_error

# Stride of the samples over which information is summed; share of its largest eigenvalue below
# which a direction is not identifiable; step of the logarithm of Stribeck's speed.
_EVERY, _SEEN, _STEP = 5, 1e-9, 1e-4


def noise_limit(case: Case) -> tuple[float, float, float]:
    """Errors of M, friction and its shape that noise alone does not exceed in 90 % of recordings.

    Those of the best unbiased estimate, with the Cramér–Rao covariance along the motion. The terms
    of friction are known, with Stribeck's in Gaussian form, but not their coefficients or
    Stribeck's speed. Loads and lags are known.
    """
    happening, machine = case.happenings[0], case.machine
    dynamics, p = compiled(case.robot), machine.plant.p
    truth = happening.truth_at(happening.time[::_EVERY])
    moving = np.all(truth.rates != 0, axis=1)
    state = (truth.z[moving], truth.qd[moving], truth.qdd[moving])
    tau = dynamics.torque(*state, p)
    sparse = dynamics.sparse_regressor(*state, tau)
    Y = np.zeros((machine.dof, len(p), len(tau)))
    np.add.at(Y, (sparse.rows, sparse.columns), sparse.values)
    link = happening.link(truth)[moving]
    further = [_further(case, i, state[1][:, i], link[:, i]) for i in range(machine.dof)]
    own = len(further[0])
    of_laws = np.zeros((machine.dof, machine.dof * own, len(tau)))
    for i, columns in enumerate(further):
        of_laws[i, i * own : (i + 1) * own] = columns
    Y = np.concatenate([Y, of_laws], axis=1)
    Y /= (case.sensors[0].noise * np.abs(tau).max(axis=0))[:, None, None]
    information = _EVERY * np.einsum("dis,djs->ij", Y, Y)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    seen = values > _SEEN * values[-1]
    rng = np.random.default_rng(0)
    chance = rng.standard_normal((100, seen.sum())) / np.sqrt(values[seen])
    off = chance @ vectors[:, seen].T * scale
    q = dynamics.kinematics.inverse(machine.poses)
    true = dynamics.mass_matrix(q, p)
    M = [largest_mass_error(dynamics.mass_matrix(q, p + d[: len(p)]), true) for d in off]
    friction = [_friction(case, d[: len(p)], d[len(p) :].reshape(machine.dof, own)) for d in off]
    of_M, of_friction, of_shape = np.quantile(np.column_stack([M, friction]), 0.9, axis=0)
    return float(of_M), float(of_friction), float(of_shape)


def _further(case: Case, i: int, v: Array, link: Array) -> Array:
    """Terms of a drive's law besides viscous and Coulomb friction: (terms, speeds)."""
    law, sign = case.happenings[0].friction, np.sign(v)
    coulomb, columns = float(law.coulomb[i]), list[Array]()
    if law.stribeck:
        knee = float(np.broadcast_to(law.knee, len(law.coulomb))[i])

        def near(knee: float) -> Array:
            return law.stribeck * coulomb * np.exp(-((v / knee) ** 2)) * sign

        columns += [near(knee), (near(knee * (1 + _STEP)) - near(knee * (1 - _STEP))) / (2 * _STEP)]
    if np.any(law.direction):
        columns += [np.ones_like(v), np.abs(v)]
    elif np.any(law.bias):
        columns.append(np.ones_like(v))
    if law.load:
        columns.append(sign * np.abs(link))
    return np.array(columns).reshape(len(columns), len(v))


def _friction(case: Case, off: Array, further: Array) -> tuple[float, float]:
    """Error of the drives' curves, and of their shapes, for errors of coefficients."""
    machine, happening, names = case.machine, case.happenings[0], case.machine.layout.names
    v = np.concatenate([-SPEEDS[::-1], SPEEDS])[:, None] * machine.largest_speed
    link = happening.carried
    true = happening.friction.curve(v, link)
    errors, shapes = list[float](), list[float]()
    for i, drive in enumerate(case.robot.drives):
        viscous, coulomb = (off[names.index(f"{kind}.{drive}")] for kind in ("viscous", "coulomb"))
        more = further[i] @ _further(case, i, v[:, i], np.full(len(v), link[i]))
        error = viscous * v[:, i] + coulomb * np.sign(v[:, i]) + more
        error /= np.max(np.abs(true[:, i]))
        errors.append(float(np.max(np.abs(error))))
        shapes.append(half_range(error))
    return max(errors), max(shapes)
