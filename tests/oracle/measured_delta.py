"""A Delta as it was really built, by its own numbers, and what instruments read of it.

Written from points and directions in the world; it knows nothing of how the package states a
geometry. Struts end at `tip(q) + side` and at `r + part + R (seat + side')`; the pose is what
SciPy's solver of equations finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from oracle.tree import Array, rot_z


@dataclass(eq=False)
class BuiltLimb:
    """Lengths in m, directions as vectors of the world.

    A motor's axis is `along`, its arm lies along `out` at angle 0 and turns towards −z; with
    `arm` None the drive is a rail along `along`. Each strut has its length, and its offsets from
    the middle at both ends.
    """

    base: Array
    along: Array
    out: Array
    arm: float | None
    zero: float
    scale: float
    seat: Array
    struts: tuple[tuple[float, Array, Array], ...]

    def tip(self, q: float) -> Array:
        p = self.zero + self.scale * q
        if self.arm is None:
            return self.base + p * self.along
        down = np.cross(self.along, self.out)  # a positive turn about the axis carries `out` here
        return self.base + self.arm * (np.cos(p) * self.out + np.sin(p) * down)


@dataclass(eq=False)
class BuiltDelta:
    """Limbs, and the half length h of a platform of two parts whose first holds limbs 1 and 2."""

    limbs: list[BuiltLimb]
    half: float | None = None
    tilts: bool = False
    tool: Array | None = None

    def tool_point(self, q: Array, start: Array) -> Array:
        tips = [limb.tip(value) for limb, value in zip(self.limbs, q, strict=True)]
        size = 3 + (self.half is not None) + 3 * self.tilts

        def gaps(y: Array) -> list[float]:
            R = Rotation.from_rotvec(y[3:6]).as_matrix() if self.tilts else np.eye(3)
            out = []
            for i, limb in enumerate(self.limbs):
                part = np.zeros(3)
                if self.half is not None:
                    u = np.array([np.cos(y[3]), np.sin(y[3]), 0])
                    part = self.half * u * (1 if i < 2 else -1)
                for length, upper, lower in limb.struts:
                    way = y[:3] + part + R @ (limb.seat + lower) - tips[i] - upper
                    out.append(np.linalg.norm(way) - length)
            return out

        found = root(gaps, np.append(start, np.zeros(size))[:size], tol=1e-14)
        assert np.abs(found.fun).max() < 1e-11
        R = Rotation.from_rotvec(found.x[3:6]).as_matrix() if self.tilts else np.eye(3)
        return found.x[:3] + (R @ self.tool if self.tilts and self.tool is not None else 0)


def built(
    rng: np.random.Generator,
    azimuths: list[float],
    base: float,
    seat: float,
    arm: float | None,
    strut: float,
    *,
    length: float = 1e-3,
    angle: float = 1e-3,
    half: float | None = None,
    spacing: float | None = None,
    scale: float = 0.0,
) -> BuiltDelta:
    """A machine that is off by normal errors: upright rails downwards without an arm."""
    limbs = []
    for azimuth in np.deg2rad(azimuths):
        R = rot_z(azimuth)
        turned = Rotation.from_rotvec(rng.normal(0, angle, 3)).as_matrix()
        along = turned @ (R[:, 1] if arm is not None else np.array([0.0, 0.0, -1.0]))
        out = R[:, 0] - (R[:, 0] @ along) * along  # what was the arm's zero but for the axis
        out /= np.linalg.norm(out)
        pairs = (
            [np.zeros(3)] if spacing is None else [-spacing / 2 * R[:, 1], spacing / 2 * R[:, 1]]
        )
        own = strut + rng.normal(0, length)
        struts = tuple(
            (own + (0 if spacing is None else rng.normal(0, length / 2)),
             side + (0 if spacing is None else rng.normal(0, length / 2, 3)), side)
            for side in pairs
        )  # fmt: skip
        limbs.append(
            BuiltLimb(
                base=base * R[:, 0] + rng.normal(0, length, 3),
                along=along,
                out=out,
                arm=None if arm is None else arm + rng.normal(0, length),
                zero=rng.normal(0, angle if arm is not None else length),
                scale=1 + rng.normal(0, scale) if scale else 1.0,
                seat=seat * R[:, 0],
                struts=struts,
            )
        )
    tool = np.array([0.0, 0.0, -0.05]) + rng.normal(0, length, 3)
    h = None if half is None else half + rng.normal(0, length)
    return BuiltDelta(limbs, h, spacing is not None, tool if spacing is not None else None)
