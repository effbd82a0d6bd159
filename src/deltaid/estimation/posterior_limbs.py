"""Limbs that were identified as equal, each with bodies of its own that scatter about these.

Limb i of n has M̄_i = L W_i Lᵀ where M̄ = L Lᵀ is the body that all share, and

    W_i = n S^-½ Z_i Z_iᵀ S^-½,    S = Σ_j Z_j Z_jᵀ,    Z_i Z_iᵀ Wishart with ν degrees of freedom

(a matrix-variate Dirichlet distribution). So each body stays consistent, the mean over the limbs is
M̄ itself, and uᵀM̄_i u, a mass or any second moment, has the relative standard deviation

    √((n − 1) / (n ν/2 + 1)),

which sets ν. Rows of M̄ that hang together scatter together, also in entries between them that are
zero in M̄; between other rows these stay zero.
"""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DescriptionError
from deltaid.estimation.free_body import connected
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import inertia_parameters, pseudo_inertia

Vectors = Float[np.ndarray, "samples _"]


def with_own_limbs(robot: RobotDescription) -> RobotDescription:
    """The same robot with bodies of each limb's own; an error if it has no limbs of one kind."""
    limbs = robot.limbs
    if limbs is None or not limbs.identical or limbs.count < 2:
        raise DescriptionError(
            "has no limbs that are the same, so there is nothing to scatter",
            where="limb tolerance",
            cure="leave it out (0): bodies of each limb are drawn by themselves already",
        )
    separate = limbs.changed(identical=False)
    bodies, shared = dict(robot.bodies), dict.fromkeys(robot.limb_bodies(0))
    for name in shared:
        body = bodies.pop(name).changed(measured=())
        bodies |= {f"{name}{i + 1}": body for i in range(limbs.count)}
    return robot.changed(limbs=separate, bodies=bodies, measured=(), sensors={})


def scattered(
    robot: RobotDescription,
    separate: RobotDescription,
    p: Vectors,
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[Vectors, list[int]]:
    """Parameters of a robot with own limbs, from p of one with limbs that are the same, and which
    of the shared ones each comes from; the tolerance is the relative standard deviation of a mass
    or second moment from limb to limb."""
    before, after = parameter_layout(robot), parameter_layout(separate)
    assert robot.limbs is not None
    count, place = robot.limbs.count, {name: i for i, name in enumerate(before.names)}
    origin = [place.get(name, -1) for name in after.names]
    parameters = p[:, origin]
    for name in robot.limb_bodies(0):
        bodies = _scattered(p[:, before.body(name)], count, tolerance, rng)
        for i in range(count):
            part = after.body(f"{name}{i + 1}")
            parameters[:, part] = bodies[:, i]
            origin[part] = range(before.body(name).start, before.body(name).stop)
    return parameters, origin


def _scattered(
    p: Float[np.ndarray, "samples 10"], count: int, tolerance: float, rng: np.random.Generator
) -> Float[np.ndarray, "samples limbs 10"]:
    M = pseudo_inertia(p)
    result = np.repeat(M[:, None], count, axis=1)
    freedom = 2.0 * ((count - 1) / tolerance**2 - 1.0) / count
    for rows in connected(np.any(M != 0, axis=0)):
        L = np.linalg.cholesky(M[:, rows[:, None], rows])
        # Z Zᵀ is Wishart (Bartlett): lower triangles, χ on the diagonal, N(0, 1) below
        Z = np.tril(rng.standard_normal((len(M), count, len(rows), len(rows))), -1)
        for i in range(len(rows)):
            Z[..., i, i] = np.sqrt(rng.chisquare(freedom - i, (len(M), count)))
        W = Z @ Z.mT
        values, V = np.linalg.eigh(W.sum(axis=1))
        H = (L @ (V / np.sqrt(values)[:, None]) @ V.mT)[:, None]
        result[:, :, rows[:, None], rows] = count * H @ W @ H.mT
    return inertia_parameters(result)
