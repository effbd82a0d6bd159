"""Data classes of a mechanism: symbolic poses, drives, joints and reach.

Everything is a CasADi SX expression of the task coordinates z = [r; ψ] (r the platform point in
the world; ψ the tool's angle, if a telescope or the platform turns it). Velocities and
accelerations are simple functions of generalised speeds (`mechanism.speeds`).
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.rotation import Path, Rotation, fixed, inverse
from deltaid.mechanism.speeds import Speeds


@dataclass(frozen=True)
class MovingBody:
    """A moving rigid body: its inertia parameters, its multiplicity and its motion.

    Attributes:
        name: the body of the description whose ten parameters it carries.
        count: number of bodies that share this motion (2 for the struts of a parallelogram).
        R_WL: constant rotation from an inertial frame L to the world W. A limb's poses are
            simplest in a frame turned with the limb; its origin is the world's.
        rotation: from link frame B to L, with ω and ω̇ in B.
        origin: of the link frame, resolved in L, with velocity and acceleration [m].

    Poses are functions of z, their rates of z and of the mechanism's generalised speeds.
    """

    name: str
    count: int
    R_WL: Float[np.ndarray, "3 3"]
    rotation: Rotation
    origin: Path

    def turned(self, by: ca.SX) -> "MovingBody":
        """The body turned about the origin of L by a constant rotation."""
        if by.is_eye():
            return self
        origin = Path(by @ self.origin.at, by @ self.origin.rate, by @ self.origin.acceleration)
        return replace(self, rotation=replace(self.rotation, R=by @ self.rotation.R), origin=origin)

    @property
    def world_rotation(self) -> ca.SX:
        """R_WB, from the link frame to the world."""
        return fixed(self.R_WL) @ self.rotation.R

    @property
    def world_origin(self) -> ca.SX:
        """r_WB, the origin of the link frame in the world [m]."""
        return fixed(self.R_WL) @ self.origin.at


@dataclass(frozen=True)
class LimbBodies:
    """Bodies of a limb: the driven one (upper arm or carriage), the strut, and the platform joint.

    Attributes:
        driven, strut: their motion.
        held: the middle of the strut joints at the platform, in the world [m].
        length: of the strut [m]; an expression with the symbols of a `LengthGrowth`, if any.
    """

    driven: MovingBody
    strut: MovingBody
    held: ca.SX
    length: float | ca.SX


@dataclass(frozen=True)
class ClosedForm:
    """Forward kinematics in closed form.

    Attributes:
        z: task coordinates as functions of the drive coordinates.
        margin: strut² less the square of the strut length that would just close the loops [m²].
        strut: that strut's length [m].
        modes: for each limb a distance in metres that is negative in the other working mode.
    """

    z: ca.SX
    margin: ca.SX
    strut: float
    modes: ca.SX


@dataclass(frozen=True)
class Mechanism:
    """Symbolic kinematics of a robot.

    Attributes:
        z: task coordinates, δ symbols.
        q: drive coordinates as functions of z (inverse kinematics).
        speeds: generalised speeds that the bodies' motion is a function of.
        bodies: all moving bodies.
        limbs: bodies of each limb, with its platform joint.
        platform: bodies of the platform, first the parts that limbs hold.
        telescope: upper and lower half of a telescope bar, and the end effector; or none.
        joints: friction joints' coordinates ϑ(z) by name, drives first.
        reach: for each limb, the distance in metres by which z is inside its reach, functions of z.
        q_symbols: δ symbols of drive coordinates, for `closure`, `modes` and `forward`.
        middles: for each rotary limb the angle that its coordinate is within 180° of [rad]; the
            loops also close with whole turns added. None for every other drive.
        closure: δ functions of z and `q_symbols` that are zero when the loops are closed [m, rad].
        modes: for each limb a distance in metres, function of z and `q_symbols`, that is negative
            when the limb is not in its described working mode.
        forward: forward kinematics in closed form; None where it needs iteration.
        drawing: (body, start, end) of lines to draw in place of the limbs, world [m].
        lengths: weights of the task coordinates in `scaled_jacobian`: 1 for r; for ψ how far it
            moves the platform's parts [m/rad], or 1 with a telescope.
        hold: one row for each limb: the axis about which its parallelogram prevents rotation; one
            column for each rotation of the platform's parts. None for a user-defined mechanism.
        period: turn of ψ [rad] that leaves the drive coordinates equal; None if every turn changes
            them.
    """

    z: ca.SX
    q: ca.SX
    speeds: Speeds
    bodies: tuple[MovingBody, ...]
    limbs: tuple[LimbBodies, ...]
    platform: tuple[MovingBody, ...]
    telescope: tuple[MovingBody, ...]
    joints: dict[str, ca.SX]
    reach: ca.SX
    q_symbols: ca.SX
    middles: tuple[float | None, ...]
    closure: ca.SX
    modes: ca.SX
    forward: ClosedForm | None
    lengths: tuple[float, ...]
    hold: ca.SX | None = None
    period: float | None = None
    drawing: tuple[tuple[str, ca.SX, ca.SX], ...] = ()

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.z.numel()

    @property
    def newton_step(self) -> ca.SX:
        """Newton step Φ_z⁻¹ Φ of the closure Φ(z, q), to be subtracted from z."""
        return inverse(ca.jacobian(self.closure, self.z)) @ self.closure

    @property
    def hold_condition(self) -> ca.SX:
        """‖N‖_F ‖N⁺‖_F / columns of `hold`: how well the parallelograms keep the parts parallel.

        Where it is infinite a part of the platform can turn with all drives locked, however good
        the Jacobian is (a constraint singularity).
        """
        if self.hold is None:
            return ca.SX(1.0)
        G = self.hold.T @ self.hold
        return ca.sqrt(ca.trace(G) * ca.trace(inverse(G))) / G.shape[0]

    @property
    def scaled_jacobian(self) -> ca.SX:
        """J = ∂q/∂z with ψ scaled to the length that it moves a platform's part."""
        return self.speeds.jacobian @ ca.diag(1 / ca.DM(self.lengths))

    @property
    def condition(self) -> ca.SX:
        """‖J‖_F ‖J⁻¹‖_F / δ of the scaled Jacobian."""
        J = self.scaled_jacobian
        return ca.sqrt(ca.sumsqr(J) * ca.sumsqr(inverse(J))) / self.dof
