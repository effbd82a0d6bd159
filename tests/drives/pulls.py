"""Forces on a robot, and friction of its ball joints, that its description lacks."""

from dataclasses import dataclass

import numpy as np

from oracle.composed import ComposedOracle
from oracle.tree import Array
from plants import Truth

# Steps of the spin of struts, and least rate of a joint (rad/s).
_ROUNDS, _RESTS = 20, 1e-9


@dataclass(frozen=True, eq=False)
class Hose:
    """A hose, cable or spring at the platform: F = force − drag v/|v| − stiffness (r − rest).

    Attributes:
        force: (3,) in the world (N).
        drag: against the platform's velocity (N); zero at rest.
        stiffness: of the spring (N/m).
        rest: (3,) position of the platform at which the spring is relaxed (m).
    """

    force: Array
    drag: float
    stiffness: float
    rest: Array

    def pull(self, truth: Truth) -> Array:
        """F on the platform, (samples, 3)."""
        v = truth.zd[:, :3]
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        way = np.divide(v, speed, out=np.zeros_like(v), where=speed > 0)
        return self.force - self.drag * way - self.stiffness * (truth.z[:, :3] - self.rest)

    def torque(self, truth: Truth) -> Array:
        """−Jᵀ F: torque that the motors must add, (samples, drives)."""
        return -np.einsum("szd,sz->sd", truth.hand[:, :3], self.pull(truth))


@dataclass(frozen=True, eq=False)
class Cable:
    """An elastic cable from the platform to a fixed point, always taut.

    Attributes:
        anchor: (3,) the fixed point in the world (m).
        stiffness: along the cable (N/m).
        slack: its length without tension (m).
    """

    anchor: Array
    stiffness: float
    slack: float

    def torque(self, truth: Truth) -> Array:
        """−Jᵀ F: torque that the motors must add, (samples, drives)."""
        along = self.anchor - truth.z[:, :3]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        pull = self.stiffness * (length - self.slack) * along / length
        return -np.einsum("szd,sz->sd", truth.hand[:, :3], pull)


@dataclass(frozen=True, eq=False)
class Balancer:
    """A spring at each drive with the torque −stiffness (q − rest); both (drives,).

    In N m/rad and rad; in N/m and m for a linear drive.
    """

    stiffness: Array
    rest: Array

    def torque(self, truth: Truth) -> Array:
        """Torque that the motors must add, (samples, drives)."""
        return self.stiffness * (truth.q - self.rest)


@dataclass(frozen=True, eq=False)
class BallJoints:
    """Dry friction of the ball joints at both ends of the struts.

    With its vector s from arm or carriage to platform a strut turns at ω = s × ṡ / |s|² + σ s, and
    on an arm with the rate q̇ about y at ω − q̇ y. It is free to turn about s, so σ makes the moments
    of both ends about s equal.

    Attributes:
        oracle: the robot.
        elbow, platform: moment of a limb's joints at each end (N m).
    """

    oracle: ComposedOracle
    elbow: float
    platform: float

    def torque(self, truth: Truth) -> Array:
        """Torque that the motors must add, (samples, drives)."""
        torque, moments = np.zeros_like(truth.q), np.array([self.elbow, self.platform])
        for k in range(len(self.oracle.limbs)):
            strut, slopes = self._turns(truth, k)
            rates = np.einsum("esid,sd->esi", slopes, truth.qd)
            along = np.einsum("esi,si->es", rates, strut)
            weights, spin = moments[:, None] * np.ones_like(along), np.zeros(len(strut))
            for _ in range(_ROUNDS):
                spin = -np.sum(weights * along, axis=0) / np.sum(weights, axis=0)
                speeds = np.linalg.norm(rates + spin[:, None] * strut, axis=2)
                weights = moments[:, None] / np.maximum(speeds, _RESTS)
            against = weights[:, :, None] * (rates + spin[:, None] * strut)
            torque += np.einsum("esid,esi->sd", slopes, against)
        return torque

    def _turns(self, truth: Truth, k: int) -> tuple[Array, Array]:
        """Directions of limb k's strut (samples, 3), and ∂ω/∂q̇ (2, samples, 3, drives) of its
        joints on arm or carriage and on the platform at σ = 0."""
        limb, q, z = self.oracle.limbs[k], truth.q[:, k], truth.z
        held = np.array([self.oracle.held(pose)[k] for pose in z])
        s = held - np.array([limb.tip(angle) for angle in q])
        slope = truth.hand[:, :3].copy()
        if self.oracle.kind != "rigid":
            step = np.array([0.0, 0.0, 0.0, 1e-6])
            ends = [[self.oracle.held(z + way)[k] for z in truth.z] for way in (step, -step)]
            by_turn = np.subtract(*ends) / 2e-6
            slope += by_turn[:, :, None] * truth.hand[:, 3:]
        if limb.arm is None:
            slope[:, :, k] -= limb.rail
        else:
            none = np.zeros_like(q)
            slope[:, :, k] -= limb.arm * np.stack([-np.sin(q), none, -np.cos(q)], 1) @ limb.axes.T
        on_platform = np.cross(s[:, :, None], slope, axis=1) / limb.strut**2
        on_arm = on_platform.copy()
        if limb.arm is not None:
            on_arm[:, :, k] -= limb.axes[:, 1]
        return s / limb.strut, np.stack([on_arm, on_platform])
