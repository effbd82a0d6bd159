"""Geometry of a calibrated printer as settings of its firmware: Klipper, Marlin, RepRapFirmware.

All three have one radius, and a rod length, an angle and an endstop for each tower; towers are
vertical to the bed. Their settings are the least-squares fit of positions over the workspace, with
free rotation and shift of the firmware's x and y axes; z is the height above the probed bed. The
residual is reported. With p_i + √(l_i² − R²) the height of tower i's joint above the bed when its
endstop triggers (p_i is the nozzle's height if all towers are equal),
    Klipper         position_endstop of each stepper is p_i
    RepRapFirmware  M665 H is the mean of p, M666 is p_i − H
    Marlin          M665 H is the least p, M666 is H − p_i: how far a carriage backs off
"""

from importlib.metadata import version

import numpy as np
from jaxtyping import Float

from deltaid.calibration.calibrate import Calibration
from deltaid.calibration.outlook import drawn
from deltaid.errors import DeltaidError
from deltaid.exports.text import rendered

# Largest angle of rails to the vertical [rad]; the fit of the other settings compensates it.
_UPRIGHT = 0.02
_KINDS = ("rail_across", "zero", "strut")


def firmware_text(calibration: Calibration, firmware: str) -> tuple[str, float]:
    """Lines for klipper, marlin or reprap, and the residual of their printer model [m].

    Raises:
        DeltaidError: the robot is no linear Delta that the firmware supports, or its bed was not
            probed.
    """
    robot, known, limbs = (
        calibration.described,
        calibration.known,
        calibration.described.limb_geometry,
    )
    assert robot.limbs is not None  # `unknowns` refuses others
    turns = np.mod(np.diff([*robot.limbs.azimuth_deg, robot.limbs.azimuth_deg[0]]), 360)
    upright = all(x.drive == "linear" and np.hypot(*x.rail[:2]) <= _UPRIGHT for x in limbs)
    by_radii = None not in (robot.limbs.base_radius, robot.limbs.platform_radius)
    if len(limbs) != 3 or not (upright and by_radii and np.allclose(turns, 120)) or known.apart:
        raise DeltaidError(
            "firmwares take three upright rails, 120° apart and anticlockwise, with equal struts",
            where=robot.name,
            cure="describe them by base_radius and platform_radius, or take the robot file",
        )
    beds = [part.state for part in calibration.fit.readings if part.instrument.kind == "probe"]
    if not beds:
        what = "no bed was probed, so heights above it are not known"
        raise DeltaidError(what, where=robot.name, cure="give --probe")
    h, *tilt = beds[0]
    (radius_change, *numbers), left = _fitted(calibration, *tilt)
    across, zero, strut = np.reshape(numbers, (3, len(limbs)))
    joints = np.array([limb.base - limb.attachment for limb in limbs])
    radius = float(np.mean(np.linalg.norm(joints[:, :2], axis=1)) + radius_change)
    rods, corrections = (
        np.array([limb.strut for limb in limbs]) + strut,
        np.rad2deg(across / radius),
    )
    text = rendered(
        "firmware.jinja",
        firmware=firmware,
        version=version("deltaid"),
        title=robot.label,
        left=left,
        radius=radius,
        rods=rods,
        endstops=(joints[:, 2] - zero - h) - np.sqrt(rods**2 - radius**2),
        azimuths=np.array(robot.limbs.azimuth_deg) + corrections,
        corrections=corrections,
        reach=float(np.abs(robot.workspace.bounding_box[:, :2]).max()),
    )
    return text, left


def _fitted(
    calibration: Calibration, a: float, b: float
) -> tuple[Float[np.ndarray, " numbers"], float]:
    """Radius, then rail_across, zero and strut of each tower, that come nearest to the calibrated
    positions over the workspace, and the residual [m]; a and b are the slopes of the bed."""
    loops, known, n = calibration.fit.loops, calibration.known, len(calibration.values)
    q = drawn(loops.kinematics, loops.limbs)
    x, slopes = loops.points(q, np.zeros(n))
    J, arms = slopes.reshape(-1, n), x - x.mean(axis=0)
    # A rotation that levels the bed; rotation about its normal and shifts along it are free.
    level = np.cross([-b, a, 0.0], x).ravel()
    plane = [np.tile(axis, len(arms)) for axis in np.eye(3)[:2]]
    free = np.column_stack([*plane, np.cross([0.0, 0.0, 1.0], arms).ravel()])
    G = np.zeros((n, 10))
    G[known.of_kind("rail_out"), 0] = 1
    for k, kind in enumerate(_KINDS):
        G[known.of_kind(kind), 1 + 3 * k + np.arange(3)] = 1
    A, target = np.column_stack([J @ G, free]), J @ calibration.values + level
    fitted = np.linalg.lstsq(A, target, rcond=None)[0]
    left = float(np.linalg.norm(target - A @ fitted) / np.sqrt(len(q)))
    return fitted[:10], left
