"""The posterior of a model by the numbers of its file, and a robot of which it can be drawn."""

from dataclasses import dataclass

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation import posterior_draws
from deltaid.model.record import IdentifiedModel
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

# Entries of M̄ = [[Σ, mc], [mcᵀ, m]] by the names that a description frees.
PLACE = {"Sxx": (0, 0), "Syy": (1, 1), "Szz": (2, 2), "m": (3, 3), "Sxy": (0, 1), "Sxz": (0, 2),
         "Syz": (1, 2), "mcx": (0, 3), "mcy": (1, 3), "mcz": (2, 3)}  # fmt: skip


def ten(M: np.ndarray) -> np.ndarray:
    """Ten parameters of pseudo-inertia matrices: Θ = tr(Σ) 1 − Σ."""
    S, m, mc = M[..., :3, :3], M[..., 3, 3], M[..., :3, 3]
    trace = np.trace(S, axis1=-2, axis2=-1)
    diagonal = trace[..., None] - np.diagonal(S, axis1=-2, axis2=-1)
    rest = [-S[..., i, j] for i, j in ((0, 1), (1, 2), (0, 2))]
    return np.concatenate([m[..., None], mc, diagonal, np.stack(rest, axis=-1)], axis=-1)


def matrices(p: np.ndarray) -> np.ndarray:
    """And back."""
    M = np.zeros((len(p), 4, 4))
    for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2))):
        M[:, i, j] = M[:, j, i] = -p[:, 7 + k]
    for i in range(3):
        M[:, i, i] = 0.5 * p[:, 4:7].sum(axis=1) - p[:, 4 + i]
    M[:, :3, 3] = M[:, 3, :3] = p[:, 1:4]
    M[:, 3, 3] = p[:, 0]
    return M


@dataclass(frozen=True, eq=False)
class Normal:
    """What data and prior say of p without any thought of consistency: p = middle + spread·y."""

    middle: np.ndarray
    spread: np.ndarray

    def draws(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return self.middle + rng.standard_normal((count, self.spread.shape[1])) @ self.spread.T


def normal(model: IdentifiedModel) -> Normal:
    """By the numbers of the model file alone."""
    robot, record, names = model.robot, model.posterior, model.layout.names
    p_prior, columns = prior_parameters(robot), []
    for b, body in enumerate(model.layout.bodies):
        hidden = [s for s, (i, j) in PLACE.items() if i == j and s not in robot.bodies[body].free]
        for entry in (*robot.bodies[body].free, *hidden):
            unit = np.zeros((4, 4))
            i, j = PLACE[entry]
            unit[i, j] = unit[j, i] = 1
            column = np.zeros(len(names))
            column[10 * b : 10 * b + 10] = ten(unit)
            touched = {names[k] for k in np.flatnonzero(column)}
            if entry in robot.bodies[body].free or touched <= set(record.unseen):
                columns.append(column)
    joints = np.eye(len(names))[10 * len(model.layout.bodies) :]
    A = np.array([*columns, *joints]).T
    K = np.array([[row.get(name, 0.0) for name in names] for row in record.combinations])
    L = np.zeros((len(K), len(K)))
    for row, numbers in zip(L, record.factor, strict=True):
        row[: len(numbers)] = numbers
    size = np.abs(p_prior)
    for b in range(len(model.layout.bodies)):
        m, second = p_prior[10 * b], 0.5 * p_prior[10 * b + 4 : 10 * b + 7].sum()
        own = m * np.array([1.0, *[np.sqrt(second / m)] * 3, *[second / m] * 6])
        part = slice(10 * b, 10 * b + 10)
        size[part] = np.where(p_prior[part] != 0, size[part], own)
    moved = np.any(A != 0, axis=1)
    W = np.linalg.inv(L)
    rows = np.vstack([W @ K @ A, A[moved] / (record.spread * size[moved])[:, None]])
    right = np.concatenate([W @ (np.array(record.values) - K @ p_prior), np.zeros(moved.sum())])
    scale = 1 / np.linalg.norm(rows, axis=0)
    Q, R = np.linalg.qr(rows * scale)
    mean, root = np.linalg.solve(R, Q.T @ right), np.linalg.inv(R)
    return Normal(p_prior + A @ (scale * mean), A @ (scale[:, None] * root))


def can_be(model: IdentifiedModel, p: np.ndarray) -> np.ndarray:
    """Which parameters are those of bodies and joints that can exist."""
    first = 10 * len(model.layout.bodies)
    inside = np.all(p[:, first:] > 0, axis=1)
    for b in range(len(model.layout.bodies)):
        inside[inside] = np.linalg.eigvalsh(matrices(p[inside, 10 * b : 10 * b + 10]))[:, 0] > 0
    return inside


def by_rejection(model: IdentifiedModel, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws of p: normal by data and prior, kept where every body and coefficient can be."""
    plain, kept = normal(model), list[np.ndarray]()
    for _ in range(100):
        if sum(map(len, kept)) >= count:
            break
        p = plain.draws(200_000, rng)
        kept.append(p[can_be(model, p)])
    assert sum(map(len, kept)) >= count, "hardly any draw can exist"
    return np.vstack(kept)[:count]


def hasten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models are drawn quickly, where nobody asks whether they are of the posterior."""
    quick = {"_CHAINS": 32, "_DRAWS": 8, "_BEFORE": 1, "_BETWEEN": 1, "_LONGER": 0}
    trusting = {"_LARGEST_RHAT": np.inf, "_LEAST_SHARE": 0.0}
    for name, value in {**quick, **trusting}.items():
        monkeypatch.setattr(posterior_draws, name, value)


ROBOT = "clavel-delta3"


def stout() -> RobotDescription:
    """The robot with bodies that are about as thick as long: of thin ones hardly any draw of a
    normal distribution can exist, and rejection would take for ever."""
    robot = load_robot(ROBOT)
    shapes = {
        "U": (1.0, (0.2, 0.0, 0.02), (0.15, 0.12, 0.1)),
        "S": (0.2, (0.5, 0.0, 0.0), (0.3, 0.25, 0.2)),
        "P": (1.0, (0.0, 0.0, 0.0), (0.06, 0.05, 0.04)),
    }
    bodies = {}
    for name, (m, centre, radii) in shapes.items():
        M = m * np.outer([*centre, 1.0], [*centre, 1.0]) + np.diag([*(m * np.square(radii)), 0.0])
        bodies[name] = robot.bodies[name].changed(prior=ExplicitInertia.from_parameters(ten(M)))
    return robot.changed(bodies=bodies)


def truth(robot: RobotDescription) -> np.ndarray:
    """Friction above the prior's, and hardly any in one drive."""
    layout, p = compiled(robot).layout, prior_parameters(robot)
    p[layout.friction] *= 1.5
    p[layout.coulomb.start] = 5e-3
    return p
