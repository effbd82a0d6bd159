"""A Delta as it was really built, by its own numbers, and what instruments read of it.

Written from points and directions in the world; it knows nothing of how the package states a
geometry. Struts end at `tip(q) + side` and at `r + part + R (seat + side')`. `numbers` says what a
machine's errors are called, to first order.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from oracle.tree import Array, rot_z


@dataclass(frozen=True)
class Drawing:
    """What a machine should have been: lengths in m, angles in degrees.

    Rails without an `arm` point downwards, turned about their limb's y by `lean`. A platform of two
    parts has its half `half`, or slides along `slide`; limbs `first` hold its first part.
    `spacing` parts the struts of a limb. Poses lie within `low` and `high` (x, y, z, ψ).
    """

    azimuths: tuple[float, ...]
    base: float | tuple[tuple[float, float], ...]
    seat: float | tuple[tuple[float, float], ...]
    arm: float | None
    strut: float
    low: tuple[float, ...]
    high: tuple[float, ...]
    lean: float = 0.0
    half: float | None = None
    slide: float | None = None
    first: tuple[int, ...] = ()
    spacing: float | None = None

    @property
    def turns(self) -> bool:
        return self.half is not None or self.slide is not None

    def poses(self, rng: np.random.Generator, count: int) -> Array:
        return rng.uniform(self.low, self.high, (count, len(self.low)))


THREE, FOUR, H4 = (0.0, 120.0, 240.0), (45.0, -45.0, 135.0, -135.0), (15.0, 165.0, 270.0, 270.0)
H4_SEATS = ((0.01, -0.02), (-0.01, -0.02), (-0.04, 0.02), (0.04, 0.02))
DRAWINGS = {
    "clavel-delta3": Drawing(
        THREE, 0.33, 0.125, 0.42, 1.055, (-0.35, -0.35, -1.1), (0.35, 0.35, -0.85)
    ),
    "anycubic-kossel": Drawing(
        THREE, 0.1654, 0.031, None, 0.267, (-0.06, -0.06, -0.5), (0.06, 0.06, -0.3)
    ),
    "linear-delta-45": Drawing(
        THREE, 0.6, 0.05, None, 0.6, (-0.14, -0.14, -0.85), (0.14, 0.14, -0.6), lean=-45.0
    ),
    "par4": Drawing(
        FOUR, 0.275, 0.06, 0.375, 0.825, (-0.25, -0.25, -0.9, -2.0), (0.25, 0.25, -0.7, 2.0),
        half=0.06, first=(0, 1),
    ),
    "h4-linear": Drawing(
        H4, ((0.4, 0.0), (-0.4, 0.0), (0.14, -0.4), (-0.14, -0.4)), H4_SEATS, None, 0.72,
        (-0.12, -0.12, -0.95, -0.7), (0.12, 0.12, -0.65, 0.7), half=0.06, first=(0, 2),
    ),
    "i4": Drawing(
        FOUR, 0.2, 0.08, 0.3, 0.7, (-0.2, -0.2, -0.8, -2.5), (0.2, 0.2, -0.6, 2.5),
        slide=90.0, first=(0, 1),
    ),
    "abb-irb360-1-1130": Drawing(
        THREE, 0.2, 0.052, 0.3545, 0.8, (-0.3, -0.3, -0.8), (0.3, 0.3, -0.6), spacing=0.08
    ),
}  # fmt: skip


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

    def tips(self, q: Array) -> Array:
        p = (self.zero + self.scale * q)[:, None]
        if self.arm is None:
            return self.base + p * self.along
        down = np.cross(self.along, self.out)  # a positive turn about the axis carries `out` here
        return self.base + self.arm * (np.cos(p) * self.out + np.sin(p) * down)


@dataclass(eq=False)
class BuiltDelta:
    """Limbs, the half length h of a platform of two parts, and the tool from the platform point."""

    drawing: Drawing
    limbs: list[BuiltLimb]
    half: float | None = None
    tool: Array | None = None

    def tool_points(self, q: Array, start: Array) -> Array:
        """Where it stands: Newton's method from points near by, slopes by differences."""
        drawing, tips = (
            self.drawing,
            [limb.tips(p) for limb, p in zip(self.limbs, q.T, strict=True)],
        )
        tilts, step = drawing.spacing is not None, 1e-6
        y = np.zeros((len(q), 3 + drawing.turns + 3 * tilts))
        y[:, :3] = start[:, :3]

        def gaps(y: Array) -> Array:
            part = np.zeros((len(y), 3))
            if self.half is not None:
                part[:, :2] = self.half * np.column_stack([np.cos(y[:, 3]), np.sin(y[:, 3])])
            elif drawing.slide is not None:
                part = y[:, [3]] * rot_z(np.deg2rad(drawing.slide))[:, 0]
            columns = []
            for i, limb in enumerate(self.limbs):
                middle = y[:, :3] + (part if i in drawing.first else -part) - tips[i]
                for length, upper, lower in limb.struts:
                    seat = limb.seat + lower
                    if tilts:
                        seat = Rotation.from_rotvec(y[:, 3:]).apply(seat)
                    columns.append(np.linalg.norm(middle + seat - upper, axis=1) - length)
            return np.column_stack(columns)

        for _ in range(20):
            c = gaps(y)
            if np.abs(c).max() < 1e-13:
                break
            changes = [gaps(y + e) - gaps(y - e) for e in step * np.eye(y.shape[1])]
            y = y - np.linalg.solve(np.stack(changes, axis=2) / (2 * step), c[..., None])[..., 0]
        assert np.abs(gaps(y)).max() < 1e-11
        return y[:, :3] + (
            0 if self.tool is None else Rotation.from_rotvec(y[:, 3:]).apply(self.tool)
        )

    def numbers(self) -> dict[str, float]:
        """The machine's errors by the package's names."""
        drawing, found = self.drawing, {}
        for i, limb in enumerate(self.limbs):
            R, base, _ = _place(drawing, i)
            off, mean = limb.base - base, np.mean([strut[0] for strut in limb.struts])
            if limb.arm is None:
                rail = _rail(drawing, i)
                across = np.cross(rail, R[:, 1]), R[:, 1]
                each = {
                    "rail_out": off @ across[0], "rail_across": off @ across[1],
                    "lean_out": limb.along @ across[0], "lean_across": limb.along @ across[1],
                    "zero": limb.zero + off @ rail, "scale": limb.scale - 1,
                }  # fmt: skip
            else:
                each = {
                    "base_out": off @ R[:, 0], "base_across": off @ R[:, 1], "base_up": off[2],
                    "azimuth": -limb.along @ R[:, 0], "tilt": limb.along[2],
                    "upper_arm": limb.arm - drawing.arm, "zero": limb.zero,
                }  # fmt: skip
            each["strut"] = mean - drawing.strut
            if drawing.spacing is not None:
                (first, upper_1, lower_1), (second, upper_2, lower_2) = limb.struts
                spacing, apart = (lower_2 - lower_1) @ R[:, 1], upper_2 - upper_1
                each |= {
                    "strut_difference": second - first,
                    "pair_out": apart @ limb.out,
                    "pair_across": apart @ limb.along - spacing,
                    "pair_up": apart @ np.cross(limb.out, limb.along),
                    "spacing": spacing - drawing.spacing,
                }
            found |= {f"limb{i + 1}.{kind}": float(value) for kind, value in each.items()}
        if self.half is not None:
            found["platform.half"] = self.half - drawing.half
        if self.tool is not None:
            found |= dict(zip(("tool_x", "tool_y", "tool_z"), self.tool - TOOL, strict=True))
        return found


TOOL = np.array([0.0, 0.0, -0.05])


def built(
    rng: np.random.Generator,
    drawing: Drawing,
    *,
    length: float = 1e-3,
    angle: float = 1e-3,
    scale: float = 0.0,
) -> BuiltDelta:
    """A machine that is off its drawing by normal errors."""
    limbs = []
    for i in range(len(drawing.azimuths)):
        R, base, seat = _place(drawing, i)
        turned = Rotation.from_rotvec(rng.normal(0, angle, 3)).as_matrix()
        along = turned @ (R[:, 1] if drawing.arm is not None else _rail(drawing, i))
        out = R[:, 0] - (R[:, 0] @ along) * along  # what was the arm's zero but for the axis
        out /= np.linalg.norm(out)
        mean = drawing.strut + rng.normal(0, length)
        struts = ((mean, np.zeros(3), np.zeros(3)),)
        if drawing.spacing is not None:
            wide = drawing.spacing + rng.normal(0, length)
            frame = np.column_stack([out, along, np.cross(out, along)])
            upper = frame @ (wide * np.eye(3)[1] + rng.normal(0, length, 3)) / 2
            difference, lower = rng.normal(0, length) / 2, R[:, 1] * wide / 2
            struts = ((mean - difference, -upper, -lower), (mean + difference, upper, lower))
        arm = None if drawing.arm is None else drawing.arm + rng.normal(0, length)
        off = rng.normal(0, length, 3)
        if arm is None:  # along a rail that is its zero
            off -= (off @ along) * along
        limbs.append(
            BuiltLimb(
                base + off, along, out, arm,
                rng.normal(0, length if arm is None else angle),
                1 + rng.normal(0, scale) if scale else 1.0, seat, struts,
            )
        )  # fmt: skip
    tool = TOOL + rng.normal(0, length, 3) if drawing.spacing is not None else None
    half = None if drawing.half is None else drawing.half + rng.normal(0, length)
    return BuiltDelta(drawing, limbs, half, tool)


def shape_error(x: Array, m: Array) -> float:
    """Root mean square of what no rigid motion explains."""
    turn, _ = Rotation.align_vectors(m - m.mean(0), x - x.mean(0))
    return float(np.sqrt(np.mean(np.sum((m - m.mean(0) - turn.apply(x - x.mean(0))) ** 2, axis=1))))


def _place(drawing: Drawing, i: int) -> tuple[Array, Array, Array]:
    """A limb's upright frame, base point and seat."""
    R = rot_z(np.deg2rad(drawing.azimuths[i]))
    return R, *(
        np.append(p[i], 0.0) if isinstance(p, tuple) else p * R[:, 0]
        for p in (drawing.base, drawing.seat)
    )


def _rail(drawing: Drawing, i: int) -> Array:
    R, lean = rot_z(np.deg2rad(drawing.azimuths[i])), np.deg2rad(drawing.lean)
    return np.sin(lean) * R[:, 0] - np.cos(lean) * R[:, 2]
