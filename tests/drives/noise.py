"""What the noise of a recording leaves of errors, whoever identifies."""

from __future__ import annotations

import numpy as np

from deltaid.dynamics.dynamics import compiled
from drives.judge import SPEEDS
from drives.rows import Case
from oracle.tree import Array

# Every how many samples information is summed over, and the share of its largest eigenvalue below
# which nothing is seen.
_EVERY, _SEEN = 5, 1e-9


def noise_limit(case: Case, draws: int = 100) -> tuple[float, float]:
    """Errors of M and friction that the noise alone leaves in 90 % of clean recordings.

    Of the best unbiased estimate (Cramér–Rao): its covariance along the motion, without faults.
    """
    happening, machine = case.happenings[0], case.machine
    dynamics, p = compiled(case.robot), machine.plant.p
    truth = happening.at(happening.time[::_EVERY])
    moving = np.all(truth.rates != 0, axis=1)
    state = (truth.z[moving], truth.qd[moving], truth.qdd[moving])
    tau = dynamics.torque(*state, p)
    sparse = dynamics.sparse_regressor(*state, tau)
    Y = np.zeros((machine.dof, len(p), len(tau)))
    np.add.at(Y, (sparse.rows, sparse.columns), sparse.values)
    Y /= (case.sensors[0].noise * np.abs(tau).max(axis=0))[:, None, None]
    information = _EVERY * np.einsum("dis,djs->ij", Y, Y)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    seen = values > _SEEN * values[-1]
    rng = np.random.default_rng(0)
    chance = rng.standard_normal((draws, seen.sum())) / np.sqrt(values[seen])
    off = chance @ vectors[:, seen].T * scale
    q = dynamics.kinematics.inverse(machine.poses)
    true = dynamics.mass_matrix(q, p)
    size = np.sqrt(np.einsum("sii,sjj->sij", true, true))
    M = [np.max(np.abs(dynamics.mass_matrix(q, p + d) - true) / size) for d in off]
    friction = [_linear_friction(case, d) for d in off]
    return float(np.quantile(M, 0.9)), float(np.quantile(friction, 0.9))


def _linear_friction(case: Case, off: Array) -> float:
    """Error of viscous and Coulomb friction for parameters that are off."""
    machine, names = case.machine, case.machine.layout.names
    errors = []
    for i, drive in enumerate(case.robot.drives):
        v = SPEEDS * machine.largest_speed[i]
        viscous, coulomb = (off[names.index(f"{kind}.{drive}")] for kind in ("viscous", "coulomb"))
        largest = machine.viscous[i] * v[-1] + machine.coulomb[i]
        errors.append(np.max(np.abs(viscous * v + coulomb)) / largest)
    return float(max(errors))
