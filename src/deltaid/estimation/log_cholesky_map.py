"""The paper's parametrisation (Sec. V): x(π) is consistent for every π, so nothing constrains π.

For each body M̄ = e^{2α} UᵀU with U upper triangular, its diagonal (e^{d₁}, e^{d₂}, e^{d₃}, 1),
products s and last column t, eqs. (12)–(14); friction and rotor coefficients are e^β, and
constant offsets of friction, which may have either sign, are β times their size. The map is
built as that product and read off, entry by entry; nothing of (14) is typed again. A completed
diagonal entry (a mass that torques cannot see) has its factor fixed to one, as the paper does with
α of the upper arm. Rows are ordered so that completed ones come last. A small share of the prior is
added, x = (…)(π) + ε x_reg, which keeps x as far from the edge as the conic program does: both
search the same set.
"""

from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import IdentificationError
from deltaid.estimation.reduction import INTERIOR, Reduction
from deltaid.estimation.regularizer import Vector
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia
from deltaid.robot.parameter import Parameter


class LogCholeskyMap:
    """The map x(π), one to one from Rⁿ onto the consistent x, with exact derivatives.

    Raises:
        IdentificationError: the entries left free do not form a pattern that a Cholesky factor has.
    """

    def __init__(self, reduction: Reduction) -> None:
        self.reduction = reduction
        self._pi = ca.SX.sym("pi", reduction.size)
        entries = ca.SX(reduction.size, 1)
        for body in reduction.layout.bodies:
            for k, value in self._body_entries(body).items():
                entries[k] = value
        for k, variable in self._coefficients():
            signed = variable.signed
            entries[k] = variable.scale * self._pi[k] if signed else ca.exp(self._pi[k])
        self._x = entries + INTERIOR * ca.DM(reduction.prior)

    def x(self, pi: Vector) -> Vector:
        """x(π)."""
        return np.asarray(self._functions(pi, np.zeros(len(pi)))[0]).ravel()

    def derivatives(self, pi: Vector, weights: Vector) -> tuple[Vector, np.ndarray, np.ndarray]:
        """x, ∂x/∂π and Σ_i weights_i ∂²x_i/∂π²."""
        x, J, H = (np.asarray(value) for value in self._functions(pi, weights))
        return x.ravel(), J, H

    def pi(self, x: Vector) -> Vector:
        """The inverse map: π(x), by Cholesky factorisation.

        Raises:
            IdentificationError: x is not consistent.
        """
        reduction, pi = self.reduction, np.empty(len(x))
        inner = x - INTERIOR * reduction.prior
        p = reduction.A @ inner + reduction.p_0
        for body in reduction.layout.bodies:
            for k, value in self._body_coordinates(body, p).items():
                pi[k] = value
        for k, variable in self._coefficients():
            pi[k] = inner[k] / variable.scale if variable.signed else np.log(inner[k])
        return pi

    def _coefficients(self) -> list[tuple[int, Parameter]]:
        """The free variables that are no entries of a body, with their positions."""
        variables = enumerate(self.reduction.variables)
        return [(k, variable) for k, variable in variables if variable.kind != "inertia"]

    @cached_property
    def _functions(self) -> ca.Function:
        weights = ca.SX.sym("w", self.reduction.size)
        H, _ = ca.hessian(ca.dot(weights, self._x), self._pi)
        J = ca.jacobian(self._x, self._pi)
        return ca.Function("map", [self._pi, weights], [ca.densify(e) for e in (self._x, J, H)])

    def _order(self, body: str) -> list[int]:
        completed = self.reduction.completed[body]
        return [i for i in range(4) if i not in completed] + list(completed)

    def _body_entries(self, body: str) -> dict[int, ca.SX]:
        """Free entries of M̄(π) of one body, by position."""
        free, order = self.reduction.entries(body), self._order(body)
        if not free:
            return {}
        alpha = self._pi[free[3, 3]] if (3, 3) in free else ca.SX(0)
        U = ca.SX(4, 4)
        for a, i in enumerate(order):
            d = self._pi[free[i, i]] if (i, i) in free and i != 3 else ca.SX(0)
            U[a, a] = ca.exp(d)
            for b in range(a + 1, 4):
                place = _sorted(i, order[b])
                if place in free:
                    U[a, b] = self._pi[free[place]]
        M = ca.exp(2 * alpha) * (U.T @ U)
        place_in = {i: a for a, i in enumerate(order)}
        entries = {}
        for entry, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            value = M[place_in[i], place_in[j]]
            if (i, j) in free:
                entries[free[i, j]] = value
            elif i != j and ca.sparsify(value).nnz():
                raise IdentificationError(
                    f"log-cholesky cannot hold {entry} at zero while its neighbours are free",
                    where=f"bodies.{body}.free",
                    cure=f"free {entry} too, or use --method conic",
                )
            elif i == j and i not in self.reduction.completed[body]:
                raise IdentificationError(
                    f"log-cholesky cannot hold {entry}, which torques show, at its prior",
                    where=f"bodies.{body}.free",
                    cure=f"free {entry} too, or use --method conic",
                )
        return entries

    def _body_coordinates(self, body: str, p: Float[np.ndarray, " parameters"]) -> dict[int, float]:
        """α, d, s, t of one body from its parameters: the Cholesky factor of M̄, row by row.

        Completed rows take no part in the factorisation; only their coupling is read.
        """
        free, order = self.reduction.entries(body), self._order(body)
        if not free:
            return {}
        M = pseudo_inertia(p[self.reduction.layout.body(body)])[np.ix_(order, order)]
        known = 4 - len(self.reduction.completed[body])
        if np.linalg.eigvalsh(M[:known, :known])[0] <= 0 if known else False:
            raise IdentificationError(
                "is not consistent, so it has no log-Cholesky factor",
                where=f"bodies.{body}",
                cure="change its prior, or use --method conic",
            )
        U = np.zeros((4, 4))
        C = np.linalg.cholesky(M[:known, :known]).T if known else np.zeros((0, 0))
        U[:known, :known] = C
        U[:known, known:] = np.linalg.solve(C.T, M[:known, known:]) if known else 0.0
        alpha = np.log(U[order.index(3), order.index(3)]) if (3, 3) in free else 0.0
        U *= np.exp(-alpha)
        coordinates = {}
        for (i, j), k in free.items():
            a, b = sorted((order.index(i), order.index(j)))
            value = U[a, b] if a != b else (alpha if i == 3 else np.log(U[a, a]))
            coordinates[k] = float(value)
        return coordinates


def _sorted(i: int, j: int) -> tuple[int, int]:
    """The place of an entry in the upper triangle."""
    return (i, j) if i <= j else (j, i)
