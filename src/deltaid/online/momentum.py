"""Filtered model torques without accelerations, by generalised momentum.

With M, C, g and f of (1), and Ṁ = C + Cᵀ because C comes from Christoffel symbols,

    τ = d/dt (M q̇) − Cᵀq̇ + g + f,

and with F, a first-order low-pass of corner K,

    F τ = K (M q̇ − F M q̇) + F (−Cᵀq̇ + g + f).

All terms are linear in the parameters p: the momentum M q̇ = H p, the rest W p. So directions D in
p, such as the entries of a load, have the filtered columns K (H D − F H D) + F W D, and

    residual ρ = F τ_measured − (filtered torque of the model) = Ψ p_load

for a robot with a load that the model does not contain; external torques on the drives are −ρ.

F of signals that are straight lines, or constant, between two samples,

    y' = K (x − y),

is solved exactly over a sample of length h: with a = e^(−Kh) and g = (1 − a) / (Kh),

    y_{k+1} = a y_k + (1 − g) x_{k+1} + (g − a) x_k     for straight lines,
    y_{k+1} = a y_k + (1 − a) x_k                       for x held from k to k + 1.

The state of each signal is one number, s_k = a y_k + (contribution of x_k), so that
y_{k+1} = s_k + … x_{k+1}.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import FrictionColumn, Sign, joint_columns
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.mechanism.mechanism import Mechanism
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Lowpass:
    """A first-order filter at one rate.

    Attributes:
        a: decay of its output over a sample.
        now, before: weights of a signal's samples at both ends of it.
    """

    a: float
    now: float
    before: float

    @classmethod
    def lines(cls, corner: float, period: float) -> "Lowpass":
        """The filter for signals that are linear between samples.

        Args:
            corner: K [1/s].
            period: h [s].
        """
        a, g = np.exp(-corner * period), -np.expm1(-corner * period) / (corner * period)
        return cls(float(a), float(1 - g), float(g - a))

    @classmethod
    def held(cls, corner: float, period: float) -> "Lowpass":
        """The filter for signals that are held from one sample to the next."""
        a = float(np.exp(-corner * period))
        return cls(a, 0.0, 1 - a)

    def output(self, kept: ca.SX, x: ca.SX) -> ca.SX:
        """y of this sample from the state."""
        return kept + self.now * x

    def keep(self, output: ca.SX, x: ca.SX) -> ca.SX:
        """The state for the next sample."""
        return self.a * output + self.before * x


@dataclass(frozen=True)
class Momentum:
    """Momentum and torques without accelerations.

    Attributes:
        z, qd: inputs, δ each.
        load: of the gears, only for load friction.
        p: symbols of the parameters.
        H: ∂(M q̇)/∂p, δ × len(p).
        W: ∂(−Cᵀq̇ + g + f)/∂p, with smooth signs of speeds.
        M: mass matrix, a function of p.
        dry: friction of each drive that the speed does not determine: terms that jump at rest, in
            proportion to the distance of the smooth sign from ±1.
    """

    z: ca.SX
    qd: ca.SX
    load: ca.SX
    p: ca.SX
    H: ca.SX
    W: ca.SX
    M: ca.SX
    dry: ca.SX


def build_momentum(
    robot: RobotDescription, mechanism: Mechanism, rest_speeds: Mapping[str, float]
) -> Momentum:
    """Derive momentum and torques.

    Args:
        rest_speeds: speed ε of each friction joint [rad/s or m/s] below which its sign is unknown:
            sign(v) = v / √(v² + ε²).
    """
    forces, speeds, dof = SpeedForces(robot, mechanism), mechanism.speeds, mechanism.dof
    N, motion = speeds.drives_to_all, speeds.by_drives()
    z, qd, qdd, load = mechanism.z, speeds.q.u, speeds.q.ud, ca.SX.sym("load", dof)
    columns, dry = [forces.body_columns()], ca.SX.zeros(dof)
    for k, column in enumerate(joint_columns(robot), start=forces.layout.coefficients.start):
        sign = _smooth_sign(rest_speeds.get(column.joint, 1.0))
        columns.append(forces.joint_columns([column], load, sign))
        if isinstance(column, FrictionColumn) and not column.term.continuous:
            most = forces.joint_columns([column], load, lambda v: ca.SX(1))
            unknown = 1 - sign(forces.joint(column.joint).path.rate) ** 2
            dry += ca.fabs(forces.p[k] * (N.T @ motion(most))) * motion(unknown)
    Y = N.T @ motion(ca.horzcat(*columns))
    H = _rate(Y, qdd, qd)
    W = ca.substitute(Y, qdd, ca.SX.zeros(dof)) - _rate(H, z, motion(speeds.z.u))
    return Momentum(z, qd, load, forces.p, H, ca.sparsify(W), forces.mass_matrix(N), dry)


def _smooth_sign(rest: float) -> Sign:
    return lambda v: v / ca.sqrt(v * v + rest * rest)


def _rate(matrix: ca.SX, x: ca.SX, xd: ca.SX) -> ca.SX:
    return ca.sparsify(ca.reshape(ca.jtimes(ca.vec(ca.densify(matrix)), x, xd), *matrix.shape))
