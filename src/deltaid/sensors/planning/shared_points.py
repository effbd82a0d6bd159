"""Points that two bodies share along a motion, found from their poses alone.

A point r_A of A stays at r_B of B if R_A r_A + o_A = R_B r_B + o_B at all samples: linear in both,
so the solutions are a point (a ball joint), a line (an axis) or all of space (one part). The
base is a body that never moves. Nothing of this knows which kind of robot it is.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.mechanism import Mechanism

# Singular values and distances below these [1, m] are zero.
_ZERO, _APART = 1e-7, 1e-8

Points = Float[np.ndarray, "samples 3"]
Turns = Float[np.ndarray, "samples 3 3"]


@dataclass(frozen=True, eq=False)
class Instance:
    """One moving body: whose parameters it has, how many move alike, where it is.

    Attributes:
        name: of the body, '' for the base.
        count: of bodies.
        R, o: pose of the link frame in the world.
    """

    name: str
    count: int
    R: Turns
    o: Points


@dataclass(frozen=True, eq=False)
class Shared:
    """Points that two bodies share: r_a + directions · λ of one, r_b + … of the other.

    Attributes:
        a, b: the point in both link frames; on a line that next to the origin of a.
        along: directions in a, one a row; none for a single point.
    """

    a: Float[np.ndarray, " 3"]
    b: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, "free 3"]
    along_b: Float[np.ndarray, "free 3"]


def instances(mechanism: Mechanism, z: Float[np.ndarray, "samples dof"]) -> tuple[Instance, ...]:
    """All bodies along a motion, the base last."""
    poses = [
        ca.horzcat(
            ca.densify(ca.DM(body.R_WL) @ body.rotation.R),
            ca.densify(ca.DM(body.R_WL) @ body.origin.at),
        )
        for body in mechanism.bodies
    ]
    values = ca.Function("poses", [mechanism.z], [ca.horzcat(*poses)])
    rows = np.stack([np.array(values(pose)) for pose in z])
    found = [
        Instance(body.name, body.count, rows[:, :, 4 * i : 4 * i + 3], rows[:, :, 4 * i + 3])
        for i, body in enumerate(mechanism.bodies)
    ]
    still = np.broadcast_to(np.eye(3), (len(z), 3, 3)), np.zeros((len(z), 3))
    return (*found, Instance("", 1, *still))


def shared(a: Instance, b: Instance) -> Shared | None:
    """The points that two bodies share; None if there is none."""
    M = np.concatenate([a.R, -b.R], axis=2).reshape(-1, 6) / np.sqrt(len(a.o))
    apart = (b.o - a.o).ravel() / np.sqrt(len(a.o))
    U, S, Vt = np.linalg.svd(M, full_matrices=False)
    rank = int(np.sum(_ZERO * S[0] < S))
    r = Vt[:rank].T @ ((U.T @ apart)[:rank] / S[:rank])
    if np.abs(M @ r - apart).max() > _APART:
        return None
    free = Vt[rank:]
    # As few directions as there are, along the axes of a where these will do.
    along = _upright(free)
    nearest, *_ = np.linalg.lstsq(along[:, :3].T, -r[:3], rcond=None) if len(along) else ([],)
    r = r + along.T @ np.asarray(nearest) if len(along) else r
    r[np.abs(r) < _APART] = 0.0
    return Shared(r[:3], r[3:], along[:, :3], along[:, 3:])


def move_alike(a: Instance, b: Instance) -> Shared | None:
    """Points of two bodies that move alike, always as far apart; None if there are none.

    Of a body that only translates all points do, and its origin is taken.
    """
    free = [body.R for body in (a, b) if np.abs(body.R - body.R[0]).max() > _APART]
    still = np.broadcast_to(np.eye(3), (len(a.o), 3, 3))
    signs = [1.0 if R is a.R else -1.0 for R in free]
    M = np.concatenate([s * R for s, R in zip(signs, free, strict=True)] + [-still], axis=2)
    M, apart = M.reshape(3 * len(a.o), -1), (b.o - a.o).ravel()
    r, *_ = np.linalg.lstsq(M, apart, rcond=_ZERO)
    if np.abs(M @ r - apart).max() > _APART:
        return None
    points = iter(np.split(r, len(free) + 1))
    r_a, r_b = (next(points) if any(body.R is R for R in free) else np.zeros(3) for body in (a, b))
    return Shared(r_a, r_b, np.zeros((0, 3)), np.zeros((0, 3)))


def turn_alike(a: Instance, b: Instance) -> Float[np.ndarray, "3 3"] | None:
    """R_BA where two bodies turn alike, and turn at all; else None."""
    R = b.R.swapaxes(1, 2) @ a.R
    constant = np.abs(R - R[0]).max() < _APART
    return R[0] if constant and np.abs(a.R - a.R[0]).max() > _APART else None


def _upright(free: Float[np.ndarray, "free 6"]) -> Float[np.ndarray, "free 6"]:
    """A basis of the same directions in reduced echelon form: unit vectors of a where possible."""
    rows, done = free.copy(), 0
    for column in range(3):
        if done == len(rows):
            break
        at = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[at, column]) < _ZERO:
            continue
        rows[[done, at]] = rows[[at, done]]
        eliminate(rows, done, column)
        done += 1
    return rows


def eliminate(rows: Float[np.ndarray, "rows columns"], k: int, column: int) -> None:
    """Make, in place, a column 1 in row k and 0 in all others, by multiples of that row."""
    rows[k] /= rows[k, column]
    others = np.arange(len(rows)) != k
    rows[others] -= np.outer(rows[others, column], rows[k])
