"""Loop closure with the geometry as unknowns: poses of the tool and their slopes.

For the pose y = [r; ψ; φ] (platform point, and tool angle and tilt where the robot has them), drive
coordinates q and numbers θ, every strut closes one loop

    c(y, q, θ) = |a(y, θ) − E(q, θ)| − l(θ) = 0

with a its joint at the platform and E the one at the elbow or carriage. The tool x(y, θ) follows,
and by implicit differentiation dx/dθ = ∂x/∂θ − ∂x/∂y (∂c/∂y)⁻¹ ∂c/∂θ.
"""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.calibration.unknowns import TOOL, Unknowns
from deltaid.errors import KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.levels import ROUNDS
from deltaid.mechanism.forward import CLOSED
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.platform import build_platform
from deltaid.mechanism.rotation import Path, Turn, fixed, rotation, skew
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.mounting import mounting_axes

Drives = Float[np.ndarray, "samples drives"]
Poses = Float[np.ndarray, "samples coordinates"]
Numbers = Float[np.ndarray, " numbers"]


class ToolPoints(NamedTuple):
    """Tool points in the world [m], and dx/dθ."""

    x: Float[np.ndarray, "samples 3"]
    slopes: Float[np.ndarray, "samples 3 numbers"]


class Loops:
    """Loop closure of a robot with limbs. The tool offset from the platform point [m] matters only
    where the platform tilts."""

    def __init__(
        self, robot: RobotDescription, known: Unknowns, tool: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> None:
        self.kinematics = Kinematics(robot)
        self.limbs, self.is_linear = len(robot.limb_geometry), robot.is_linear("drive1")
        self._size = 6 if known.apart else self.limbs
        theta = ca.SX.sym("theta", len(known.numbers))
        y, q = ca.SX.sym("y", self._size), ca.SX.sym("q", self.limbs)
        *limbs, platform = known.by_limb(ca.vertsplit(theta))
        z = ca.vertcat(y[:3], y[3:] if not known.apart else ca.SX(0, 1))
        points = build_platform(robot, Path.still(z), platform.get("half")).points
        turn, x = ca.SX.eye(3), y[:3]
        if known.apart:  # rotation to third order, exact for tilts that struts allow
            S = skew(y[3:6])
            turn += S + S @ S / 2 + S @ S @ S / 6
        c = ca.vertcat(*(
            _gap(limb, limbs[i], q[i], (y[:3], turn, points[i].at - y[:3]), side)
            for i, limb in enumerate(robot.limb_geometry)
            for side in ((-0.5, 0.5) if known.apart else (0.0,))
        ))  # fmt: skip
        if known.apart:
            x += turn @ (ca.DM(list(tool)) + ca.vertcat(*[platform[key] for key in TOOL]))
        parts = [c, x, *(ca.jacobian(f, by) for f in (c, x) for by in (y, theta))]
        self._shapes = [part.shape for part in parts]
        inputs, dense = ca.vertcat(y, q), [ca.vec(ca.densify(part)) for part in parts]
        self._newton = BatchKernel(inputs, ca.vertcat(c, ca.vec(ca.jacobian(c, y))), theta)
        self._all = BatchKernel(inputs, ca.vertcat(*dense), theta)

    def start(self, q: Drives) -> Poses:
        """Poses of the described robot; NaN where its loops do not close."""
        # a fourth drive turns the tool alone, where the robot has a telescope
        all_drives = np.pad(q, ((0, 0), (0, self.kinematics.dof - self.limbs)))
        z = self.kinematics.forward_unchecked(all_drives)[0][:, : min(self._size, self.limbs)]
        return np.pad(z, ((0, 0), (0, self._size - z.shape[1])))

    def inverse(self, x: Float[np.ndarray, "samples 3"]) -> Drives:
        """Drive coordinates of the described robot at platform points, the tool at its home angle.
        Raises a KinematicsError where a point is out of reach."""
        z = np.tile(self.kinematics.home, (len(x), 1))
        z[:, :3] = x
        return self.kinematics.inverse(z)[:, : self.limbs]

    def points(self, q: Drives, theta: Numbers) -> ToolPoints:
        """Tool points and their slopes, by Newton's method from the described robot's poses. Raises
        a KinematicsError with the sample where loops do not close."""
        y, size = self.start(q), self._size
        c = np.full(y.shape, np.inf)
        for _ in range(ROUNDS):
            out = self._newton(np.hstack([y, q]).T, theta).T
            c, C_y = out[:, :size], out[:, size:].reshape(-1, size, size).swapaxes(1, 2)
            try:
                with np.errstate(all="ignore"):
                    y = y - np.linalg.solve(C_y, c[..., None])[..., 0]
            except np.linalg.LinAlgError:
                break
            if not np.max(np.abs(c), initial=0.0) > CLOSED:
                break
        open_ = ~(np.abs(c).max(axis=1) < 1e3 * CLOSED)
        if open_.any():
            raise KinematicsError(
                "the loops do not close with the estimated geometry",
                where=f"pose {open_.argmax()}",
                cure="check this pose; or hold some numbers, such as --hold upper_arm",
            )
        ends = np.cumsum([rows * columns for rows, columns in self._shapes])
        blocks = np.split(self._all(np.hstack([y, q]).T, theta).T, ends[:-1], axis=1)
        _, x, C_y, C_theta, X_y, X_theta = (
            block.reshape(-1, *shape[::-1]).swapaxes(1, 2)  # CasADi stores columns
            for block, shape in zip(blocks, self._shapes, strict=True)
        )
        X_c = np.linalg.solve(C_y.swapaxes(1, 2), X_y.swapaxes(1, 2)).swapaxes(1, 2)
        return ToolPoints(x[..., 0], X_theta - X_c @ C_theta)


def _turn(axis: str, angle: ca.SX) -> ca.SX:
    return rotation(Turn(axis, ca.cos(angle), ca.sin(angle), ca.SX(0), ca.SX(0))).R


def _gap(
    limb: LimbGeometry, own: dict[str, ca.SX], q: ca.SX, platform: tuple[ca.SX, ...], side: float
) -> ca.SX:
    """|a − E| − l of a limb with its numbers, or of one of its struts.

    Args:
        platform: the platform point, the platform's turn, and the limb's seat from that point.
        side: −½ or ½ for the first or second strut of a pair, 0 for one that represents both.
    """
    r, turn, seat = platform
    q = own["zero"] + q * (1 + own.get("scale", 0.0))
    axes = fixed(mounting_axes(limb))
    if limb.drive == "rotary":
        # the frame L is the upright one, turned about its x by the tilt
        frame: ca.SX = _turn("z", own["azimuth"]) @ fixed(limb.R_WL) @ _turn("x", own["tilt"])
        moved, arm = [own["base_out"], own["base_across"], own["base_up"]], limb.upper_arm
        arm += own["upper_arm"]
        elbow = frame @ ca.vertcat(arm * ca.cos(q), 0, -arm * ca.sin(q))
    else:
        frame, moved = fixed(limb.R_WL), [own["rail_out"], own["rail_across"], 0]
        leant = axes @ _turn("x", own["lean_across"]) @ _turn("y", -own["lean_out"])
        elbow = -q * leant[:, 2]
    elbow, strut = fixed(limb.base) + axes @ ca.vertcat(*moved) + elbow, limb.strut + own["strut"]
    if side:
        along = (limb.spacing or 0.0) + own["spacing"]
        pair = ca.vertcat(own["pair_out"], along + own["pair_across"], own["pair_up"])
        elbow += side * frame @ pair
        seat = seat + side * fixed(limb.R_WL[:, 1]) * along
        strut += side * own["strut_difference"]
    return ca.norm_2(r + turn @ seat - elbow) - strut
