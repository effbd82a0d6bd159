"""Generalised speeds of a mechanism: u = (q̇, ż, w), as in Kane's method.

Velocities of bodies are simple functions of u; w are the rates of passive joints. The closed loops,
differentiated once and twice, relate drives and platform,

    A ż = B q̇,    A z̈ = B q̈ + c(q̇, ż),    B diagonal,

so J = ∂q/∂z = B⁻¹ A and T = ∂z/∂q = A⁻¹ B, and neither inverse nor forward kinematics is ever
differentiated. With y = q or y = z, u = N ẏ; forces Q on u become Nᵀ Q on y.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from deltaid.mechanism.rotation import reciprocal


@dataclass(frozen=True)
class Speed:
    """Generalised speeds as symbols, and their values.

    Attributes:
        u, ud: symbols of the speeds and of their derivatives by time.
        value, rate: expressions for both; empty for q̇ and ż, which the closed loops relate.
    """

    u: ca.SX
    ud: ca.SX
    value: ca.SX
    rate: ca.SX

    @classmethod
    def named(cls, name: str, count: int) -> "Speed":
        """Speeds as new symbols."""
        symbols = ca.SX.sym(name, count), ca.SX.sym(f"{name}_dot", count)
        return cls(*symbols, ca.SX(0, 1), ca.SX(0, 1))

    @classmethod
    def joined(cls, speeds: Sequence["Speed"]) -> "Speed":
        """Several speeds as one vector."""
        fields = ("u", "ud", "value", "rate")
        return cls(*(ca.vertcat(*(getattr(s, field) for s in speeds)) for field in fields))

    def __getitem__(self, k: slice) -> "Speed":
        return Speed(self.u[k], self.ud[k], self.value, self.rate)

    def being(self, value: ca.SX, rate: ca.SX) -> "Speed":
        """The same symbols with new expressions."""
        return replace(self, value=value, rate=rate)


# Evaluates an expression of the symbols u, u̇ along a motion that is given by q̇ or ż.
Along = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class Speeds:
    """Generalised speeds of a mechanism and the relations between them.

    Attributes:
        q, z: speeds of drives and of the platform.
        w: those of passive joints, functions of q̇ and ż.
        A, B, c: coefficients of the closed loops.
    """

    q: Speed
    z: Speed
    w: Speed
    A: ca.SX
    B: ca.SX
    c: ca.SX

    @property
    def u(self) -> ca.SX:
        """Symbols of all speeds."""
        return ca.vertcat(self.q.u, self.z.u, self.w.u)

    def by_drives(self) -> Along:
        """Given q̇ and q̈: ż = T q̇, z̈ = A⁻¹ (B q̈ + c)."""
        inverse = self._inverse
        zd = inverse @ (self.B @ self.q.u)
        c = ca.substitute(self.c, self.z.u, zd)
        zdd = inverse @ (self.B @ self.q.ud + c)
        return self._motion((self.q.u, self.q.ud), (zd, zdd))

    def by_task(self) -> Along:
        """Given ż and z̈: q̇ = J ż, q̈ = B⁻¹ (A z̈ − c)."""
        over_gain = self._over_gain
        qd = over_gain @ (self.A @ self.z.u)
        c = ca.substitute(self.c, self.q.u, qd)
        qdd = over_gain @ (self.A @ self.z.ud - c)
        return self._motion((qd, qdd), (self.z.u, self.z.ud))

    def _motion(self, q: tuple[ca.SX, ca.SX], z: tuple[ca.SX, ca.SX]) -> Along:
        known = ca.vertcat(self.q.u, self.z.u, self.q.ud, self.z.ud)
        values = ca.vertcat(q[0], z[0], q[1], z[1])
        w, wd = ca.substitute([self.w.value, self.w.rate], [known], [values])
        symbols = ca.vertcat(self.u, self.q.ud, self.z.ud, self.w.ud)
        motion = ca.vertcat(q[0], z[0], w, q[1], z[1], wd)
        return lambda expression: ca.substitute(expression, symbols, motion)

    @property
    def jacobian(self) -> ca.SX:
        """The Jacobian J = ∂q/∂z."""
        return self._over_gain @ self.A

    @property
    def inverse_jacobian(self) -> ca.SX:
        """The inverse Jacobian T = ∂z/∂q."""
        return self._inverse @ self.B

    @property
    def _inverse(self) -> ca.SX:
        """A⁻¹, with a single division."""
        return reciprocal(ca.det(self.A)) * ca.adj(self.A)

    @property
    def _over_gain(self) -> ca.SX:
        return ca.diag(reciprocal(ca.diag(self.B)))

    @property
    def drives_to_all(self) -> ca.SX:
        """The matrix N = ∂u/∂q̇."""
        return self._partial(ca.SX.eye(self.q.u.numel()), self.inverse_jacobian)

    @property
    def task_to_all(self) -> ca.SX:
        """The matrix N = ∂u/∂ż."""
        return self._partial(self.jacobian, ca.SX.eye(self.z.u.numel()))

    @property
    def locked_to_all(self) -> ca.SX:
        """∂u/∂ż for locked drives, q̇ = 0, as if the loops were open."""
        n = self.z.u.numel()
        return self._partial(ca.SX(n, n), ca.SX.eye(n))

    def _partial(self, q: ca.SX, z: ca.SX) -> ca.SX:
        """∂u/∂ẏ from ∂q̇/∂ẏ and ∂ż/∂ẏ."""
        w = ca.jacobian(self.w.value, self.q.u) @ q + ca.jacobian(self.w.value, self.z.u) @ z
        return ca.vertcat(q, z, w)
