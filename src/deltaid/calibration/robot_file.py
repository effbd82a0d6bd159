"""A robot file with an estimated geometry, as far as its keys can hold it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from deltaid.calibration.loops import mounting_axes
from deltaid.calibration.unknowns import APART, TOOL, Unknowns
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import Limbs
from deltaid.robot.platform import H4Platform, Par4Platform
from deltaid.robot.tolerances import LENGTHS, Tolerances

# A rail that leans more than this from the vertical has an azimuth that turns it sideways: half.
_LEANS = 0.5


def calibrated_robot(
    robot: RobotDescription,
    known: Unknowns,
    theta: Float[np.ndarray, " numbers"],
    std: Float[np.ndarray, " numbers"],
) -> tuple[RobotDescription, dict[str, float], dict[str, float], Bool[np.ndarray, " numbers"]]:
    """The robot with estimated numbers and their standard deviations as tolerances.

    Base joints take what base and platform differ by; limbs' joints at the platform stay where
    they are described. Motor axes turn by azimuth and tilt; zeros of rails move their base points.

    Args:
        robot: as described.
        known: its numbers.
        theta, std: their estimates and standard deviations.

    Returns:
        The robot; zeros of rotary drives [rad] and scales of drives, which no key holds, by drive;
        which numbers all that holds.
    """
    limbs = robot.limbs
    assert limbs is not None  # unknowns refuse others
    *each, platform = known.by_limb(theta.tolist())
    half, rotary = platform.get("half", 0.0), limbs.drive == "rotary"
    upright = abs(limbs.geometry()[0].rail[0]) <= _LEANS
    unheld = (*APART, *TOOL, *(("lean_across",) if upright else ()))
    held = np.array([number.kind not in unheld for number in known.numbers])
    updates: dict[str, object] = {
        "limbs": limbs.changed(**_changed(limbs, each)),
        "tolerances": _tolerances(robot, known, std),
    }
    if isinstance(robot.platform, H4Platform):
        updates["platform"] = robot.platform.changed(half_length=robot.platform.half_length + half)
    elif isinstance(robot.platform, Par4Platform):
        updates["platform"] = robot.platform.changed(length=robot.platform.length + 2 * half)
    zeros = {f"drive{i + 1}": numbers["zero"] for i, numbers in enumerate(each)} if rotary else {}
    said = "deltaid calibrate"
    if zeros:
        listed = ", ".join(f"{drive} {-value:.6f}" for drive, value in zeros.items())
        said += f"; not in this file: zero of each drive's column, rad: {listed}"
    updates["sources"] = {k: v for k, v in robot.sources.items() if not k.startswith("limbs.")} | {
        "limbs": said
    }
    scales = {} if rotary else {f"drive{i + 1}": numbers["scale"] for i, numbers in enumerate(each)}
    return robot.changed(**updates), zeros, scales, held


def _changed(limbs: Limbs, each: Sequence[dict[str, float]]) -> dict[str, object]:
    """Keys of limbs with their estimated numbers."""
    rotary = limbs.drive == "rotary"
    bases, azimuths, tilts = [], [], []
    given = np.broadcast_to(limbs.tilt_deg, limbs.count)
    for limb, numbers, azimuth, tilt in zip(
        limbs.geometry(), each, limbs.azimuth_deg, given, strict=True
    ):
        if rotary:
            by, sideways = (
                [numbers["base_out"], numbers["base_across"], numbers["base_up"]],
                numbers["azimuth"],
            )
        else:
            by = [numbers["rail_out"], numbers["rail_across"], -numbers["zero"]]
            leans = abs(limb.rail[0]) > _LEANS
            sideways = numbers["lean_across"] / limb.rail[0] if leans else 0.0
        bases.append(tuple((limb.base + mounting_axes(limb) @ by).tolist()))
        azimuths.append(azimuth + float(np.rad2deg(sideways)))
        tilts.append(float(tilt + np.rad2deg(numbers["tilt" if rotary else "lean_out"])))
    changed: dict[str, object] = {
        "base_radius": None,
        "platform_radius": None,
        "platform_points": tuple(tuple(limb.attachment.tolist()) for limb in limbs.geometry()),
        "base_points": tuple(bases),
        "azimuth_deg": tuple(azimuths),
        "tilt_deg": tuple(tilts),
    }
    for kind in ("strut", "upper_arm") if rotary else ("strut",):
        changed[kind] = tuple(
            getattr(limb, kind) + numbers[kind]
            for limb, numbers in zip(limbs.geometry(), each, strict=True)
        )
    return changed


def _tolerances(
    robot: RobotDescription, known: Unknowns, std: Float[np.ndarray, " numbers"]
) -> Tolerances:
    """The largest standard deviation of each kind of length, and that of each drive's zero."""
    prefixes = {"base_radius": ("base_", "rail_"), "upper_arm": ("upper_arm",), "strut": ("strut",),
                "platform": ("half",)}  # fmt: skip
    lengths = {name: robot.tolerances.of_length(name) for name in LENGTHS}
    for name, starts in prefixes.items():
        own = [k for k, number in enumerate(known.numbers) if number.kind.startswith(starts)]
        if own:
            lengths[name] = float(std[own].max())
    lengths["platform_radius"] = lengths["base_radius"]
    homing = {drive: robot.tolerances.of_drive(drive) for drive in robot.drives}
    for s, number in zip(std, known.numbers, strict=True):
        if number.kind == "zero":
            homing[f"drive{number.limb + 1}"] = float(s)
    return robot.tolerances.changed(lengths=lengths, homing=homing)
