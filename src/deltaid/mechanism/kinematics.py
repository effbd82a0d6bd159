"""Numeric kinematics of a robot: inverse, forward, Jacobians and poses, with clear errors."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import KinematicsError
from deltaid.kernel.batch import RowKernel, row_kernel
from deltaid.mechanism.composition import build_mechanism
from deltaid.mechanism.forward import CLOSED, ForwardKinematics, forward_kinematics
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.one_or_many import not_finite, one_or_many
from deltaid.mechanism.regularity import SINGULAR_CONDITION, Regularity, passages, written
from deltaid.mechanism.rotation import inverse
from deltaid.mechanism.tree_joints import (
    BallJoints,
    JointStates,
    PassiveJoints,
    TreeJoints,
    tree_joints,
)
from deltaid.robot.load import RobotLike, load_robot
from deltaid.shown import Plotted, Shown

Samples = Float[np.ndarray, "samples dof"]

_CHECK_DRIVES = (
    "check the drives' unit, sign and zero (rotary: 0 = arm horizontal, positive = down), and the "
    "lengths in the robot's description"
)


@dataclass(frozen=True, repr=False)
class BodyPoses(Shown):
    """Poses of a moving body, one or many samples: R_WB takes link frame B to the world."""

    name: str
    R_WB: Float[np.ndarray, "*samples 3 3"]
    r_WB: Float[np.ndarray, "*samples 3"]


class Kinematics(Shown, Plotted):
    """Kinematics of a described robot. Arrays have one sample a row; kernels compile on first use.

    A single sample may be given as a vector; results then have no axis of samples.

    z = [x, y, z of the platform point in the world; ψ with a telescope], in m and rad.
    """

    def __init__(self, robot: RobotLike) -> None:
        robot = load_robot(robot)
        self.robot = robot
        self.mechanism: Mechanism = build_mechanism(robot)

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.mechanism.dof

    @one_or_many("z")
    def inverse(self, z: Samples) -> Samples:
        """Drive coordinates q(z) in the described working mode.

        Raises:
            KinematicsError: a limb cannot reach the pose, or its arm and strut are in line; names
                the sample and the limb.
        """
        q, reach = self._inverse_kernel.rows(z)
        self._require_reach(z, reach)
        return q

    @one_or_many("q")
    def forward(self, q: Samples) -> Samples:
        """Task coordinates z(q) in the described working mode.

        In closed form for three limbs that hold one platform (below or above the elbows, as in the
        home pose), else by Newton's method from the home pose, on its side of singularities
        (`mechanism.forward`); rows are then consecutive samples of a motion.

        Raises:
            KinematicsError: no platform position closes the loops, its Jacobian is singular, or a
                limb is in its other working mode.
        """
        solution = self._forward(q)
        bad = np.flatnonzero(~solution.closed)
        for drive in np.flatnonzero(~np.isfinite(q[bad[:1]]))[:1].tolist():
            raise not_finite("q", q, int(bad[0]), drive)
        if bad.size:
            raise KinematicsError(
                f"no platform position closes the loops at q = {written(q[bad[0]])}"
                f"{solution.missing(int(bad[0]))}",
                where=f"sample {bad[0]}",
                cure=_CHECK_DRIVES,
            )
        self.require_regular(solution.z)
        wrong = np.flatnonzero(~solution.in_mode)
        if wrong.size:
            raise KinematicsError(
                f"{self._wrong_mode(int(solution.limb[wrong[0]]))} at q = {written(q[wrong[0]])}",
                where=f"sample {wrong[0]}",
                cure=f"{_CHECK_DRIVES}; limbs.working_mode says how the robot is assembled",
            )
        return solution.z

    @one_or_many("q")
    def forward_unchecked(self, q: Samples) -> tuple[Samples, Bool[np.ndarray, " samples"]]:
        """z(q), and whether each sample is valid.

        z is NaN where the loops do not close or a limb is in its other working mode.
        """
        solution = self._forward(q)
        good = solution.on_branch
        return np.where(good[:, None], solution.z, np.nan), good

    def why_not(self, q: Samples) -> str:
        """Why `forward_unchecked` calls a drive position invalid."""
        solution = self._forward(np.atleast_2d(q))
        if not solution.closed[0]:
            return f"the loops do not close{solution.missing(0)}"
        return self._wrong_mode(int(solution.limb[0]))

    def _wrong_mode(self, limb: int) -> str:
        """How a limb's posture differs from the description, in words; −1: beyond a singularity."""
        if limb < 0:
            return "the loops close only beyond a singularity from the home pose"
        geometry = self.robot.limb_geometry[limb]
        if geometry.drive == "linear":
            side = "below" if geometry.outwards else "above"
            return f"the carriage of limb {limb + 1} is {side} its joint on the platform"
        return f"the elbow of limb {limb + 1} points {'in' if geometry.outwards else 'out'}wards"

    @one_or_many("z")
    def jacobian(self, z: Samples) -> Float[np.ndarray, "samples dof dof"]:
        """J = ∂q/∂z, so that q̇ = J ż."""
        return self._jacobian_kernel.rows(z)[0]

    @one_or_many("z")
    def platform_jacobian(self, z: Samples) -> Float[np.ndarray, "samples 3 dof"]:
        """∂x/∂q of the platform point x in the world, so that ẋ = (∂x/∂q) q̇."""
        J_x = np.zeros((len(z), 3, self.dof))
        J_x[:, self.robot.task.axes] = self._platform_kernel.rows(z)[0]
        return J_x

    @one_or_many("z", "zd")
    def jacobian_rate(self, z: Samples, zd: Samples) -> Float[np.ndarray, "samples dof dof"]:
        """J̇, so that q̈ = J z̈ + J̇ ż."""
        return self._jacobian_rate_kernel.rows(z, zd)[0]

    @one_or_many("z")
    def condition(self, z: Samples) -> Float[np.ndarray, " samples"]:
        """‖J‖_F ‖J⁻¹‖_F / δ: 1 at best, infinite at a singular pose, NaN out of reach."""
        return self.regularity(z).condition

    @one_or_many("z")
    def regularity(self, z: Samples) -> Regularity:
        """Condition, determinant and gain of the Jacobian."""
        return Regularity(*(part[:, 0] for part in self._regularity_kernel.rows(z)))

    def passages(self, z: Samples) -> Int[np.ndarray, " passages"]:
        """Samples i of a motion z(t) such that it passes through a singularity between i and i + 1.

        Beyond a singularity a robot is on another branch than its home pose. The same drive
        coordinates often have a solution on the home pose's branch as well: z(q) then turns back
        where the robot went on.
        """
        return passages(self.regularity(z))

    @one_or_many("z", "zd", "zdd")
    def drive_motion(self, z: Samples, zd: Samples, zdd: Samples) -> tuple[Samples, ...]:
        """(q, q̇, q̈) of a motion given in task coordinates.

        Raises:
            KinematicsError: a pose is out of reach or singular.
        """
        q = self.inverse(z)
        self.require_regular(z)
        return q, *self._motion_kernel.rows(z, zd, zdd)

    @one_or_many("z")
    def poses(self, z: Samples) -> tuple[BodyPoses, ...]:
        """Poses of all moving bodies, in the order of `Mechanism.bodies`."""
        out, bodies = self._pose_kernel.rows(z), self.mechanism.bodies
        poses = zip(bodies, out[::2], out[1::2], strict=True)
        return tuple(BodyPoses(b.name, b.R_WL @ R_LB, r @ b.R_WL.T) for b, R_LB, r in poses)

    @one_or_many("q", "qd")
    def joint_states(self, q: Samples, qd: Samples | None = None) -> JointStates:
        """All joints of the robot's tree, drives first.

        Names, signs and zeros are those of the MJCF and URDF exports (`mechanism.tree_joints`).

        Args:
            q: drive coordinates; rows are consecutive samples, as in `forward`.
            qd: drive velocities; without them the result has no velocities.

        Raises:
            KinematicsError: q closes no loop or is singular.
            DeltaidError: the mechanism is user-defined, so its joints are not known.
        """
        return self._all_joints.states(self.forward(q), qd)

    @one_or_many("z", "qd")
    def passive_joints(self, z: Samples, qd: Samples | None = None) -> JointStates:
        """Joint states of the passive joints at task coordinates z; NaN out of reach.

        Raises:
            DeltaidError: the mechanism is user-defined, so its joints are not known.
        """
        return self._passive_joints.states(z, qd)

    @cached_property
    def _all_joints(self) -> TreeJoints:
        return tree_joints(self.robot, self.mechanism)

    @cached_property
    def _passive_joints(self) -> TreeJoints:
        return tree_joints(self.robot, self.mechanism, passive=True)

    def require_regular(self, z: Samples) -> None:
        """Raise KinematicsError when a pose is singular."""
        self.regularity(z).require(z, linear=self.robot.is_linear("drive1"))

    def _require_reach(self, z: Samples, reach: Float[np.ndarray, "samples limbs"]) -> None:
        bad = np.argwhere(~(reach > CLOSED))
        if bad.size:
            i, limb = bad[0]
            if abs(reach[i, limb]) <= CLOSED:
                stretched = f"arm and struts of limb {limb + 1} lie in line"
                if self.robot.is_linear("drive1"):
                    stretched = f"the struts of limb {limb + 1} stand square to its rail"
                raise KinematicsError(
                    f"the pose z = {written(z[i])} is singular: {stretched}",
                    where=f"sample {i}",
                    cure="keep the motion away from the edge of the workspace",
                )
            raise KinematicsError(
                f"limb {limb + 1} cannot reach the pose z = {written(z[i])}: "
                f"{-reach[i, limb]:.4g} m are missing",
                where=f"sample {i}",
                cure="platform positions are in metres with z up, so they have z < 0",
            )

    _inverse_kernel = row_kernel("mechanism", lambda m: ([m.z], (m.q, m.reach)))
    _jacobian_kernel = row_kernel("mechanism", lambda m: ([m.z], [ca.horzsplit(m.speeds.jacobian)]))

    @cached_property
    def _forward(self) -> ForwardKinematics:
        at_home = self.regularity(self.home[None])
        if np.isfinite(at_home.determinant[0]) and not at_home.worst[0] < SINGULAR_CONDITION:
            raise KinematicsError(
                f"the middle of the workspace, z = {written(self.home)}, is singular",
                where="workspace",
                cure="forward kinematics starts there; arrange the limbs less symmetrically (docs: "
                "mechanisms), or move the workspace",
            )
        return forward_kinematics(self.mechanism, self.home)

    @property
    def home(self) -> Float[np.ndarray, " dof"]:
        """A pose z in the middle of the workspace, with ψ in the middle of its range."""
        return self.robot.home

    @cached_property
    def passive_friction(self) -> PassiveJoints:
        """Passive joints with friction."""
        names = [joint for joint in self.robot.friction_joints if joint not in self.robot.drives]
        return PassiveJoints(self.mechanism, names)

    @cached_property
    def ball_joints(self) -> BallJoints:
        """Ball joints at the ends of struts."""
        return BallJoints(self.mechanism)

    @cached_property
    def _platform_kernel(self) -> RowKernel:
        T = self.mechanism.speeds.inverse_jacobian[self.robot.task.moves, :]
        return RowKernel([self.mechanism.z], [ca.horzsplit(T)])

    _motion_kernel = row_kernel(
        "mechanism",
        lambda m: (
            (m.z, m.speeds.z.u, m.speeds.z.ud),
            ca.vertsplit(m.speeds.by_task()(ca.vertcat(m.speeds.q.u, m.speeds.q.ud)), m.dof),
        ),
    )
    _jacobian_rate_kernel = row_kernel(
        "mechanism",
        lambda m: (
            (m.z, m.speeds.z.u),
            [ca.vertsplit(ca.jtimes(ca.vec(m.speeds.jacobian), m.z, m.speeds.z.u), m.dof)],
        ),
    )
    _pose_kernel = row_kernel(
        "mechanism",
        lambda m: (
            [m.z],
            [part for b in m.bodies for part in (ca.horzsplit(b.rotation.R), b.origin.at)],
        ),
    )

    @cached_property
    def _regularity_kernel(self) -> RowKernel:
        m, J = self.mechanism, self.mechanism.scaled_jacobian
        gain = ca.sqrt(ca.sumsqr(inverse(J)))
        condition = ca.sqrt(ca.sumsqr(J)) * gain / self.dof
        return RowKernel([m.z], (condition, ca.det(J), gain, m.hold_condition))
