"""Places and directions in which limbs are mounted, and a description's limbs mounted otherwise."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.robot.limbs import LimbGeometry, Limbs, rotation

# Sine of a rail's angle to the vertical from which its sideways lean is a change of azimuth.
_LEANS = 0.5

Unit = Literal["m", "rad", ""]
# Unit and name of each number of a limb's mounting, by its kind.
Kinds = dict[str, tuple[Unit, str]]
DRIVES: Kinds = {
    "base_out": ("m", "base radius"), "base_across": ("m", "base sideways"),
    "base_up": ("m", "base height"), "azimuth": ("rad", "axis azimuth"),
    "tilt": ("rad", "axis tilt"),
}  # fmt: skip
RAILS: Kinds = {
    "rail_out": ("m", "rail radius"), "rail_across": ("m", "rail sideways"),
    "lean_out": ("rad", "rail lean out"), "lean_across": ("rad", "rail lean aside"),
}  # fmt: skip


def leans(limb: LimbGeometry) -> bool:
    """Whether a rail leans so much that a description can state its sideways lean."""
    return abs(float(limb.rail[0])) > _LEANS


def mounting_axes(limb: LimbGeometry) -> Float[np.ndarray, "3 3"]:
    """Axes of a limb's mounting. For a rotary limb out, across and up, the axes of L without its
    tilt about x. For a rail across it in the limb's plane (outwards where it is upright), across it
    sideways, and against its positive direction."""
    if limb.drive == "rotary":
        out, up = limb.R_WL[:, 0], np.array([0.0, 0.0, 1.0])
        return np.column_stack([out, np.cross(up, out), up])
    return limb.R_WL @ rotation("y", -float(np.rad2deg(np.arctan2(limb.rail[0], -limb.rail[2]))))


def moved_and_turned(kind: str, limb: LimbGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the base point and turn of the limb by a number of its mounting, in the
    limb's frame; zero for other kinds."""
    none, x, y, z = np.zeros(3), *np.eye(3)
    axes = limb.R_WL.T @ mounting_axes(limb)
    return {
        "base_out": (axes @ x, none), "base_across": (axes @ y, none), "base_up": (axes @ z, none),
        "azimuth": (none, limb.R_WL.T @ z), "tilt": (none, x),
        "rail_out": (axes @ x, none), "rail_across": (axes @ y, none),
        "lean_out": (none, axes @ -y), "lean_across": (none, axes @ x),
    }.get(kind, (none, none))  # fmt: skip


def remounted(limbs: Limbs, each: Sequence[Mapping[str, float]]) -> dict[str, object]:
    """Changes of a description by numbers of each limb's mounting, by kind, and by zeros of rails.

    Joints at the platform keep their described places. Motor axes turn by azimuth and tilt; zeros
    of rails move base points.
    """
    geometry, bases, turns = (
        limbs.geometry(),
        list[tuple[float, ...]](),
        list[tuple[float, float]](),
    )
    for limb, numbers in zip(geometry, each, strict=True):
        x = dict.fromkeys((*DRIVES, *RAILS, "zero"), 0.0) | dict(numbers)
        if limb.drive == "rotary":
            by, turn = (x["base_out"], x["base_across"], x["base_up"]), (x["azimuth"], x["tilt"])
        else:
            by = x["rail_out"], x["rail_across"], -x["zero"]
            aside = x["lean_across"] / float(limb.rail[0]) if leans(limb) else 0.0
            turn = aside, x["lean_out"]
        bases.append(tuple((limb.base + mounting_axes(limb) @ by).tolist()))
        turns.append(turn)
    described = limbs.azimuth_deg, np.broadcast_to(limbs.tilt_deg, limbs.count)
    azimuths, tilts = np.rad2deg(turns).T + np.stack(described)
    return {
        "base_radius": None,
        "platform_radius": None,
        "platform_points": tuple(tuple(limb.attachment.tolist()) for limb in geometry),
        "base_points": tuple(bases),
        "azimuth_deg": tuple(azimuths.tolist()),
        "tilt_deg": tuple(tilts.tolist()),
    }
