"""The load that is held, the model's own errors and friction, estimated together cycle by cycle.

    ρ = Ψ p_load + Φ c + d + noise

Ψ and Φ are filtered columns (`signals`). c are errors of the model: constants with the covariance
that the identification left, and the drives' friction, which may change slowly. d is torque that
the model has not and that stays for some hundredths of a second, one number a drive; how large it
is on this robot is learnt from how large it is found to be, E(d² + P_dd) = 1 in units of its size.
Because all are estimated together, what the robot showed of c while it was empty, or carried a load
before, stays, and what it did not show remains in the load's interval however long it is held.

Only the load begins anew when it is taken.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.online.changes import Onsets, Rules, after, change, waits
from deltaid.online.filtered import Lowpass
from deltaid.online.graph import Given, Kept, Part, chosen
from deltaid.online.kalman import Estimate
from deltaid.online.knowledge import Knowledge
from deltaid.online.layout import Field
from deltaid.online.settings import OnlineSettings
from deltaid.online.signals import Signals

Bounds = tuple[tuple[float, ...], tuple[float, ...]]

# Memory [s] of a load, of the model's own errors, and of torques that the model has not.
_LOAD, _MODEL, _UNMODELLED = 1e6, 300.0, 0.05
# How fast [s] the size of torques that the model has not is learnt, within which bounds, and the
# most by which one cycle counts.
_LEVEL, _LEVELS, _LARGEST_STEP = 2.0, (0.15, 20.0), 10.0
# Below this share of the largest mass a load's own shape says nothing of how its release looks.
_LEAST_SHARE = 0.01
# A load that the gripper tells of may be taken so much later [s]; until then, what torques say of
# it is forgotten within this time [s].
_GRIPS, _LOOSE = 0.05, 0.01
# A change must be likely for so long, in time constants of the filter.
_CONFIRMED = 1.0
# Torques whose direction no speed tells stay for so long [s].
_AT_REST = 0.02


@dataclass(frozen=True, eq=False)
class Estimates:
    """What one cycle knows.

    Attributes:
        rows: what each drive's residual shows of the states; δ × n.
        innovations: residual less all that was expected of load, model and friction, δ.
        variances: of the noise of one cycle's residual, δ.
        before: mean and covariance of the states before this cycle's residual told anything.
        behind: and after it.
        held: 1 while a load is held, behind this cycle.
        changed: 1 where that is another one from now on.
        told: 1 where the gripper told that.
        differs: 1 where the gripper tells something else than what was held before.
        load: entries of the load, consistent; zero while none is held.
        lacking: size of torques that the model has not, δ.
        part: of the graph.
    """

    rows: ca.SX
    innovations: ca.SX
    variances: ca.SX
    before: Estimate
    behind: Estimate
    held: ca.SX
    changed: ca.SX
    told: ca.SX
    differs: ca.SX
    load: ca.SX
    lacking: ca.SX
    part: Part


def estimates(
    s: Signals,
    known: Knowledge,
    settings: OnlineSettings,
    touched: ca.SX,
    bounds: Bounds,
) -> Estimates:
    """The second part of a cycle.

    Args:
        touched: 1 where something pushes the robot, so that a residual says nothing of the rest.
        bounds: of the followed friction, in deviations.
    """
    period, n_load = settings.period, len(known.entries.shown)
    moving, slow = ca.SX.sym("moving", s.qd.numel()), ca.SX.sym("slow", s.qd.numel())
    parts = known.unmodelled * moving, known.unmodelled_slow * slow * s.slow
    lacking = ca.SX(parts[0]) + parts[1]
    rows = ca.horzcat(s.smooth_columns, ca.diag(lacking))
    kinds = _kinds(known, s)
    stays = ca.SX(np.exp(-period / np.array(_memory(settings))[kinds]))
    gripping = ca.SX.sym("gripping")
    stays[:n_load] = ca.if_else(gripping > 0.5 * period, np.exp(-period / _LOOSE), stays[0])
    n, held = rows.shape[1], ca.SX.sym("held")
    x, packed = ca.SX.sym("x", n), ca.SX.sym("P", ca.Sparsity.lower(n).nnz())
    P = ca.tril2symm(ca.SX(ca.Sparsity.lower(n), packed))
    prior = ca.vertcat(*(held if kind == 0 else ca.SX(1) for kind in kinds))
    before = Estimate(x, P).forgotten(stays, prior, ca.SX((kinds == 3).astype(float)))
    innovations = s.smooth_residual - rows @ before.x
    variances = ca.SX(known.noise**2) + (_AT_REST / period) * s.dry**2
    gripper = s.gripper
    differs = waits(held, gripper)
    weight = s.live * (1 - touched) * (1 - differs)
    unit = ca.vertcat(ca.SX(1), ca.SX.zeros(n_load - 1))
    of_load = before.x[:n_load] / ca.fmax(before.x[0], _LEAST_SHARE)
    shape = chosen(ca.logic_and(held, before.x[0] > _LEAST_SHARE), of_load, unit)
    once, twice = s.columns[:, :n_load] @ shape, rows[:, :n_load] @ shape
    lowpass = Lowpass.lines(settings.corner, period)
    behind, onsets = before, Onsets.named(n, s.qd.numel(), lowpass, period)
    for i in range(s.qd.numel()):
        behind, told = behind.measured(rows[i, :], s.smooth_residual[i], variances[i], weight)
        onsets = onsets.told(i, twice, told)
    seen = onsets.likeliest
    spread = ca.sqrt(ca.fmax(behind.P[0, 0], 0))
    rules = Rules(
        known.least_mass / known.load_scales[0],
        settings.alarm,
        _CONFIRMED / settings.corner,
        settings.grip_time,
        period,
    )
    found = change(seen, held, gripper, behind.x[0], spread, rules)
    of_drives = slice(n - s.qd.numel(), n)
    size = behind.x[of_drives] ** 2 + ca.diag(behind.P)[of_drives] - 1
    judged = ca.logic_and(gripper <= -0.5, ca.fabs(seen.score) > settings.alarm)
    calm = weight * (1 - judged)
    step = period / _LEVEL * calm * ca.fmin(size, _LARGEST_STEP)
    behind = after(_bounded(behind, s.at_friction, bounds, calm), seen, found, n_load)
    at = slice(0, n_load)
    load = known.entries.consistent(
        behind.x[at], behind.P[at, at], known.load_scales, settings.extent
    )
    load = chosen(found.held, load, ca.SX.zeros(n_load))
    std = ca.sqrt(ca.fmax(ca.diag(behind.P)[at], 0)) * ca.SX(known.load_scales)
    initial = np.diag(np.where(kinds == 0, 0.0, 1.0))
    kept = (
        Kept(Field("x", n, "estimate, in deviations of its prior"), x, behind.x),
        Kept(
            Field("P", packed.numel(), "its covariance, columns of the lower triangle",
                  initial=tuple(initial.T[np.triu_indices(n)].tolist())),
            packed,
            ca.tril(ca.densify(behind.P)).nz[:],
        ),
        *(_level(name, level, step * (part / lacking) ** 2)
          for name, level, part in zip(("moving", "slow"), (moving, slow), parts, strict=True)),
        Kept(
            Field("gripping", 1, "for which a load may still be on its way", "s"),
            gripping,
            ca.if_else(ca.logic_and(found.told, found.held), _GRIPS, ca.fmax(gripping - period, 0)),
        ),
        *found.kept,
        *onsets.kept(found.changed, once, twice),
    )  # fmt: skip
    names = ", ".join(known.entries.names)
    given = (
        Given(Field("held", 1, "1 while a load is held"), found.held),
        Given(Field("changed", 1, "1 in the cycle in which that changed"), found.changed),
        Given(Field("load", n_load, f"entries of the load: {names}"), load),
        Given(Field("load_std", n_load, "their standard deviations"), std),
        Given(Field("change_score", 1, "deviations by which the mass looks changed"), seen.score),
        Given(
            Field("unnoticed", 1, "mass that may have been taken without being noticed", "kg"),
            _unnoticed(onsets, found.held, gripper, settings.alarm) * known.load_scales[0],
        ),
        Given(Field("residual", s.qd.numel(), "torque that the empty model lacks"), s.residual),
        Given(Field("unexplained", s.qd.numel(), "what load and model leave of it"), innovations),
    )
    return Estimates(
        rows, innovations, variances, before, behind,
        found.held, found.changed, found.told, differs, load, lacking,
        Part(kept, given),
    )  # fmt: skip


def _level(name: str, level: ca.SX, step: ca.SX) -> Kept:
    """The size of what a model lacks, in units of what was thought, which grows by a share."""
    doc = f"how much more than thought the model lacks of {name} drives"
    grown = level * (1 + step)
    bounded = ca.fmin(ca.fmax(grown, _LEVELS[0]), _LEVELS[1])
    return Kept(Field(f"{name}_level", level.numel(), doc, initial=1.0), level, bounded)


def _unnoticed(onsets: Onsets, held: ca.SX, gripper: ca.SX, alarm: float) -> ca.SX:
    """Mass that is no change yet, in units of the largest; none where the gripper tells."""
    known = onsets.each[0].information
    for one in onsets.each[1:]:
        known = ca.fmax(known, one.information)
    open_ = ca.logic_and(gripper <= -0.5, ca.logic_not(held))
    return ca.if_else(open_, ca.fmin(1.0, alarm / ca.sqrt(known + 1e-12)), 0.0)


def _kinds(known: Knowledge, s: Signals) -> np.ndarray:
    """For each state: 0 load, 1 model, 2 friction, 3 unmodelled."""
    parts = (s.at_load, 0), (s.at_directions, 1), (s.at_friction, 2), (s.at_lacked, 1)
    sizes = [part.stop - part.start for part, _ in parts]
    return np.repeat([*(kind for _, kind in parts), 3], [*sizes, s.qd.numel()])


def _memory(settings: OnlineSettings) -> tuple[float, ...]:
    return _LOAD, _MODEL, settings.friction_time, _UNMODELLED


def _bounded(estimate: Estimate, at: slice, bounds: Bounds, calm: ca.SX) -> Estimate:
    """With friction within its bounds.

    What hangs together with a coefficient moves with it, x + P_k (bound − x_k) / P_kk: that is the
    likeliest estimate at the bound. If the coefficient moved alone, the others would no longer fit
    what was measured, and the next cycle would throw them about.

    Args:
        calm: 1 unless the load may have changed: what that did is taken back as it was.
    """
    x, P = ca.SX(estimate.x), estimate.P
    for k, low, high in zip(range(at.start, at.stop), *bounds, strict=True):
        beyond = calm * (ca.fmin(ca.fmax(x[k], low), high) - x[k])
        x = x + P[:, k] * (beyond / ca.fmax(P[k, k], 1e-12))
    return Estimate(x, P)
