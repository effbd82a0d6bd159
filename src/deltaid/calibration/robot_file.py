"""A robot file with an estimated geometry, as far as its keys can hold it."""

import numpy as np
from jaxtyping import Bool, Float

from deltaid.calibration.loops import rail_frame, upright
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
    value = dict(zip(known.names, theta.tolist(), strict=True))
    held = np.ones(len(theta), dtype=bool)
    each = [_of_limb(value, i) for i in range(limbs.count)]
    rotary = limbs.drive == "rotary"
    changed = (_rotary if rotary else _linear)(limbs, each)
    for k, number in enumerate(known.numbers):
        upright_rail = abs(limbs.geometry()[number.limb].rail[0]) <= _LEANS
        held[k] = number.kind not in (*APART, *TOOL) and not (
            number.kind == "lean_across" and upright_rail
        )
    updates: dict[str, object] = {
        "limbs": limbs.changed(
            base_radius=None,
            platform_radius=None,
            platform_points=tuple(tuple(limb.attachment.tolist()) for limb in limbs.geometry()),
            strut=tuple(
                limb.strut + own["strut"] for limb, own in zip(limbs.geometry(), each, strict=True)
            ),
            **changed,
        ),
        "tolerances": _tolerances(robot, known, std),
    }
    if "platform.half" in value and isinstance(robot.platform, H4Platform):
        half = robot.platform.half_length + value["platform.half"]
        updates["platform"] = robot.platform.changed(half_length=half)
    elif "platform.half" in value and isinstance(robot.platform, Par4Platform):
        length = robot.platform.length + 2 * value["platform.half"]
        updates["platform"] = robot.platform.changed(length=length)
    zeros = {f"drive{i + 1}": own["zero"] for i, own in enumerate(each)} if rotary else {}
    said = "deltaid calibrate"
    if zeros:
        listed = ", ".join(f"{drive} {-value:.6f}" for drive, value in zeros.items())
        said += f"; not in this file: zero of each drive's column, rad: {listed}"
    updates["sources"] = {k: v for k, v in robot.sources.items() if not k.startswith("limbs.")} | {
        "limbs": said
    }
    scales = {} if rotary else {f"drive{i + 1}": own["scale"] for i, own in enumerate(each)}
    return robot.changed(**updates), zeros, scales, held


def _of_limb(value: dict[str, float], limb: int) -> dict[str, float]:
    prefix = f"limb{limb + 1}."
    return {k.removeprefix(prefix): v for k, v in value.items() if k.startswith(prefix)}


def _tilts(limbs: Limbs) -> tuple[float, ...]:
    given = limbs.tilt_deg
    return given if isinstance(given, tuple) else (given,) * limbs.count


def _rotary(limbs: Limbs, each: list[dict[str, float]]) -> dict[str, object]:
    bases, azimuths, tilts, arms = [], [], [], []
    for i, (limb, own) in enumerate(zip(limbs.geometry(), each, strict=True)):
        moved = [own["base_out"], own["base_across"], own["base_up"]]
        bases.append(tuple((limb.base + upright(limb) @ moved).tolist()))
        azimuths.append(limbs.azimuth_deg[i] + float(np.rad2deg(own["azimuth"])))
        tilts.append(_tilts(limbs)[i] + float(np.rad2deg(own["tilt"])))
        arms.append(limb.upper_arm + own["upper_arm"])
    return {
        "base_points": tuple(bases), "azimuth_deg": tuple(azimuths), "tilt_deg": tuple(tilts),
        "upper_arm": tuple(arms),
    }  # fmt: skip


def _linear(limbs: Limbs, each: list[dict[str, float]]) -> dict[str, object]:
    bases, azimuths, tilts = [], [], []
    for i, (limb, own) in enumerate(zip(limbs.geometry(), each, strict=True)):
        moved = [own["rail_out"], own["rail_across"], -own["zero"]]
        bases.append(tuple((limb.base + rail_frame(limb) @ moved).tolist()))
        out = float(limb.rail[0])
        sideways = own["lean_across"] / out if abs(out) > _LEANS else 0.0
        azimuths.append(limbs.azimuth_deg[i] + float(np.rad2deg(sideways)))
        tilts.append(_tilts(limbs)[i] + float(np.rad2deg(own["lean_out"])))
    return {
        "base_points": tuple(bases), "azimuth_deg": tuple(azimuths), "tilt_deg": tuple(tilts)
    }  # fmt: skip


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
