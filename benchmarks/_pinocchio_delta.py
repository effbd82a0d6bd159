"""A Delta with telescope bar in Pinocchio: spanning tree, loop closure, projected regressor.

Pinocchio sees the tree that is left when the loops are cut where struts and telescope meet the
platform. Nothing of deltaid's mechanics is used, only the description's lengths: the tree's
coordinates come from closed form, its velocities and accelerations from Pinocchio's own Jacobians
and drift accelerations at the cuts.

Joint frames are deltaid's link frames: U_i revolute about y, S_i a universal joint (y, z) at the
elbow, P three translations, EE revolute about z on P, TU the Cardan joint Rz(ψ) Rx Ry, TL a slide
along TU's z. Joints are numbered subtree by subtree, as Pinocchio wants them. No body needs a
massless neighbour, so the tree is as small as Pinocchio allows.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaid.robot.description import RobotDescription
from oracle.tree import rot_z

Array = NDArray[np.float64]

BLOCK = 200  # samples whose limbs are summed at once; the fastest size
BODIES = ("U", "S", "P", "EE", "TU", "TL")  # the order of the projected regressor's columns
DRIVES = [0, 3, 6, 13]  # among the tree's coordinates: the upper arms' angles and ψ
EE = 12  # the end effector's angle
# deltaid's order of the ten parameters, m mc xx yy zz xy yz xz, in Pinocchio's, where the tensor
# comes as xx xy yy xz yz zz.
PARAMETER_ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]


@dataclass(frozen=True)
class TreeMotion:
    """Closed-loop motion of the tree: coordinates, velocities, accelerations, and Gᵀ.

    Attributes:
        q, v, a: samples × 17.
        G_T: transposed G = ∂v/∂q̇, samples × 4 × 17.
    """

    q: Array
    v: Array
    a: Array
    G_T: Array


class PinocchioDelta:
    """Pinocchio's model of a described Delta with telescope bar."""

    def __init__(self, robot: RobotDescription) -> None:
        if robot.telescope is None:
            raise ValueError("this tree is of a Delta with telescope bar")
        self._limbs, self._telescope = robot.limbs, robot.telescope
        self.model = pin.Model()
        self.model.gravity.linear = np.array(robot.gravity)
        self._cuts: list[tuple[int, int]] = []
        self._build()
        self._data = self.model.createData()
        self._rest = [k for k in range(self.model.nv) if k not in DRIVES]

    def motion(self, z: Array, qd: Array, qdd: Array) -> TreeMotion:
        """The tree's motion at task coordinates z and drive velocities and accelerations."""
        q = self._tree_coordinates(z)
        v, a = np.empty_like(q), np.empty_like(q)
        G_T = np.empty((len(q), len(DRIVES), self.model.nv))
        for i in range(len(q)):
            closure = self._closure(q[i])
            inverse = np.linalg.inv(closure[:, self._rest])
            G = np.zeros((self.model.nv, len(DRIVES)))
            G[DRIVES] = np.eye(len(DRIVES))
            G[self._rest] = -inverse @ closure[:, DRIVES]
            v[i] = G @ qd[i]
            a[i] = G @ qdd[i]
            a[i, self._rest] -= inverse @ self._drift(q[i], v[i])
            G_T[i] = G.T
        return TreeMotion(q, v, a, G_T)

    def regressor(self, motion: TreeMotion) -> Array:
        """Inertial regressor on the drives, samples × 4 × 60, columns as BODIES, 10 each.

        A sample is one call of `computeJointTorqueRegressor` and one product with Gᵀ; identical
        limbs' columns are then summed for a block of samples at once, which costs Pinocchio least.
        """
        compute, model, data = pin.computeJointTorqueRegressor, self.model, self._data
        Y = np.empty((len(motion.q), len(DRIVES), 10 * len(BODIES)))
        projected = np.empty((BLOCK, len(DRIVES), 10 * (model.njoints - 1)))
        for start in range(0, len(Y), BLOCK):
            block = slice(start, start + BLOCK)
            rows = (motion.q[block], motion.v[block], motion.a[block], motion.G_T[block])
            for q, v, a, G_T, out in zip(*rows, projected, strict=False):
                np.dot(G_T, compute(model, data, q, v, a), out)
            self._sum_limbs(projected, Y[block])
        return Y

    def _sum_limbs(self, projected: Array, out: Array) -> None:
        """Add up the columns of the three U and of all S; the other bodies' are copied."""
        Y = projected[: len(out)]
        np.add(Y[:, :, :20], Y[:, :, 20:40], out=out[:, :, :20])
        out[:, :, :20] += Y[:, :, 40:60]
        out[:, :, 10:20] *= self._limbs.struts_per_limb
        out[:, :, 20:] = Y[:, :, 60:]

    def largest_gap(self, motion: TreeMotion) -> float:
        """Largest gap [m] at the cuts over all samples: 0 if the coordinates close the loops."""
        return float(np.abs([self._gaps(q) for q in motion.q]).max())

    def _build(self) -> None:
        ex, ey, ez = np.eye(3)
        limbs = self._limbs
        tips, seats = [], []
        for azimuth in np.deg2rad(limbs.azimuth_deg):
            R = rot_z(azimuth)
            upper = self._joint(0, pin.JointModelRY(), limbs.base_radius * R[:, 0], R)
            strut = self._joint(upper, pin.JointModelUniversal(ey, ez), limbs.upper_arm * ex)
            tips.append((strut, limbs.strut * ex))
            seats.append(limbs.platform_radius * R[:, 0])
        platform = self._joint(0, pin.JointModelTranslation(), np.zeros(3))
        self._joint(platform, pin.JointModelRZ(), np.zeros(3))
        cardan = pin.JointModelComposite()
        for joint in (pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRY()):
            cardan.addJoint(joint, pin.SE3.Identity())
        bar = self._joint(0, cardan, np.array(self._telescope.base_joint))
        lower = self._joint(bar, pin.JointModelPZ(), np.zeros(3))
        tips.append((lower, np.zeros(3)))
        seats.append(np.array(self._telescope.platform_joint))
        for (joint, point), seat in zip(tips, seats, strict=True):
            self._cuts.append((self._frame(joint, point), self._frame(platform, seat)))

    def _joint(self, parent: int, joint: object, point: Array, R: Array | None = None) -> int:
        placement = pin.SE3(np.eye(3) if R is None else R, point)
        return self.model.addJoint(parent, joint, placement, f"joint{self.model.njoints}")

    def _frame(self, joint: int, point: Array) -> int:
        name, placement = f"frame{self.model.nframes}", pin.SE3(np.eye(3), point)
        return self.model.addFrame(pin.Frame(name, joint, placement, pin.FrameType.OP_FRAME))

    def _tree_coordinates(self, z: Array) -> Array:
        """All joint coordinates in closed form, elbows outwards; NaN out of reach."""
        r, psi = z[:, :3], z[:, 3]
        limbs = [self._limb_coordinates(r, phi) for phi in np.deg2rad(self._limbs.azimuth_deg)]
        span = np.array(self._telescope.base_joint) - r - np.array(self._telescope.platform_joint)
        length = np.linalg.norm(span, axis=1)
        c, s = np.cos(psi), np.sin(psi)
        x, y = c * span[:, 0] + s * span[:, 1], c * span[:, 1] - s * span[:, 0]
        bar = [psi, np.arctan2(-y, span[:, 2]), np.arcsin(x / length), -length]
        return np.column_stack([*limbs, r, psi, *bar])

    def _limb_coordinates(self, r: Array, azimuth: float) -> Array:
        """Upper arm's angle and the two angles of the strut against it, samples × 3."""
        arm, strut = self._limbs.upper_arm, self._limbs.strut
        x, y, height = (r @ rot_z(azimuth)).T
        x = x + self._limbs.platform_radius - self._limbs.base_radius
        squares = x**2 + y**2 + height**2 + arm**2 - strut**2
        q = np.arctan2(-height, x) - np.arccos(squares / (2 * arm * np.hypot(x, height)))
        along, down = x - arm * np.cos(q), -height - arm * np.sin(q)
        return np.column_stack([q, np.arctan2(down, along) - q, np.arcsin(y / strut)])

    def _closure(self, q: Array) -> Array:
        """The 13 × 17 matrix K of the loops, K v = 0: twelve gaps at the cuts, EE turns with ψ."""
        pin.computeJointJacobians(self.model, self._data, q)
        K = np.zeros((3 * len(self._cuts) + 1, self.model.nv))
        for k, (tip, seat) in enumerate(self._cuts):
            K[3 * k : 3 * k + 3] = self._jacobian(tip) - self._jacobian(seat)
        K[-1, [EE, DRIVES[-1]]] = 1.0, -1.0
        return K

    def _jacobian(self, frame: int) -> Array:
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.getFrameJacobian(self.model, self._data, frame, aligned)[:3]

    def _drift(self, q: Array, v: Array) -> Array:
        """K̇ v: the gaps' accelerations while all joint accelerations are zero."""
        pin.forwardKinematics(self.model, self._data, q, v, np.zeros(self.model.nv))
        pairs = [self._acceleration(tip) - self._acceleration(seat) for tip, seat in self._cuts]
        return np.append(np.concatenate(pairs), 0.0)

    def _acceleration(self, frame: int) -> Array:
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.getFrameClassicalAcceleration(self.model, self._data, frame, aligned).linear

    def _gaps(self, q: Array) -> Array:
        pin.framesForwardKinematics(self.model, self._data, q)
        at = self._data.oMf
        return np.array([at[tip].translation - at[seat].translation for tip, seat in self._cuts])
