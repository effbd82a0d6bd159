"""Friction at rest as friction: impulses of all friction joints over one time step, as a graph.

Over a step of length h the friction of joint j gives an impulse λ_j of any size within
[−h F_j⁺, h F_j⁻]; F⁺ and F⁻ are its friction while it moves forwards and backwards. With the speeds
v⁰ that the joints would have without friction, and their response A = R M⁻¹ Rᵀ to impulses, the
speeds after the step are v = v⁰ + A λ, and λ is the minimiser of

    ½ λᵀ A λ + λᵀ v⁰   over the box.

Its conditions are Coulomb's law: a joint inside its bounds rests, a joint that moves has the bound
against its motion (Moreau's and Jean's scheme). A is singular where more joints have friction than
there are drives; v is unique all the same.

The minimiser is found without a branch, so that a vector register of states goes through at once:
1. Start where all drives rest, moved into the box.
2. A sweep of projected Gauss–Seidel: it lets joints go or holds them.
3. Newton steps on the joints inside their bounds, as far as the nearest bound: exact once it is
   known who rests; one step, and one more for each joint that has friction beside the drives.
Steps 2 and 3 lower the objective, so they cannot run in circles. Five rounds of both reach rounding
wherever at most one joint beside the drives has friction, as in all robots of the catalogue. With
two such joints one random case in a thousand keeps an error of some per cent of the impulses of
that step.
"""

import casadi as ca

from deltaid.dynamics.task_dynamics import cholesky_solve

_ROUNDS = 5
# Share of its diagonal that keeps A invertible where joints that rest depend on each other; the
# speeds err by this share of what friction does in a step.
_EASE = 1e-12
# Nearer to a bound than this share of the box, an impulse is at the bound.
_AT_BOUND = 1e-12


def friction_impulses(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, drives: int) -> ca.SX:
    """The minimiser of ½ λᵀ A λ + λᵀ v over low ≤ λ ≤ high.

    Args:
        A: response of the joints' speeds to impulses, symmetric, positive semidefinite.
        v: speeds without friction.
        low, high: bounds of the impulses, low ≤ 0 ≤ high.
        drives: the first so many joints are drives, whose part of A is regular.
    """
    n = v.numel()
    impulse = ca.SX.zeros(n)
    if drives:
        impulse[:drives] = cholesky_solve(A[:drives, :drives], -v[:drives])
    impulse = _into(impulse, low, high)
    for _ in range(_ROUNDS):
        impulse = _sweep(A, v, low, high, impulse)
        for _ in range(1 + n - drives):
            impulse = _newton(A, v, low, high, impulse)
    return impulse


def _sweep(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, impulse: ca.SX) -> ca.SX:
    """Each joint in turn brought to rest, as far as its bounds allow."""
    impulse = ca.SX(impulse)
    for j in range(v.numel()):
        speed = v[j] + A[j, :] @ impulse
        impulse[j] = _into(impulse[j] - speed / A[j, j], low[j], high[j])
    return impulse


def _newton(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, impulse: ca.SX) -> ca.SX:
    """All joints inside their bounds brought to rest together, as far as the first bound."""
    n, edge = v.numel(), _AT_BOUND * (high - low)
    inside = (impulse > low + edge) * (impulse < high - edge)
    free = A * (inside @ inside.T)
    for j in range(n):
        free[j, j] = inside[j] * A[j, j] * (1 + _EASE) + (1 - inside[j])
    step = inside * cholesky_solve(free, -inside * (v + A @ impulse))
    share = ca.SX(1)
    for j in range(n):
        room = ca.if_else(step[j] > 0, high[j] - impulse[j], impulse[j] - low[j])
        blocks = ca.fabs(step[j]) > room
        share = ca.fmin(share, ca.if_else(blocks, room / ca.fabs(step[j]), 1))
    return _into(impulse + share * step, low, high)


def _into(x: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    return ca.fmax(low, ca.fmin(high, x))
