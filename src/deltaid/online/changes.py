"""Detect when a load is taken or released, from the gripper's signal or from residuals.

A load that changes by Δ at a time θ moves the filter's innovations by G Δ and its estimates by F Δ,

    G = ψ − h F,   F ← F + gain · G,   F = 0 at θ,

for a measurement with the row h and the change's column ψ: the load's filtered column without the
filters' memory from before θ, when nothing was held. Innovations ν are white with variances s as
long as nothing changes, so

    D = Σ G ν / s,   C = Σ G² / s,   score D / √C,   Δ = D / C  with variance 1 / C

is the likelihood ratio of a change at θ (Willsky and Jones), which accounts for the filter's
response since then. A fixed number of times θ is stored, so memory and work are bounded. When
a change is accepted, its effect on the other estimates is removed, and the load begins with Δ.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from deltaid.online.graph import CycleFields, Field, every
from deltaid.online.kalman import UNMODELLED, Estimate, Update
from deltaid.online.momentum import Lowpass
from deltaid.online.settings import SOON, OnlineSettings

# Spacing of candidate onsets, and time after an onset within which a load becomes significant [s].
# Onsets are kept for this time plus the largest delay of a gripper's signal, `SOON`.
EVERY, _SHORT_LIFE = 0.01, 0.15


class Onset(NamedTuple):
    """F, D and C since a candidate onset θ, or since several in columns, with the memory of both
    filters of the load's column from before θ."""

    moved: ca.SX
    evidence: ca.SX
    information: ca.SX
    once: ca.SX
    twice: ca.SX

    def later(self, lowpass: Lowpass, stays: ca.SX) -> "Onset":
        """The onsets one cycle later.

        Args:
            stays: share of each estimate that is kept over a cycle.
        """
        once, moved = lowpass.a * self.once, self.moved * ca.repmat(stays, 1, self.moved.shape[1])
        twice = lowpass.output(lowpass.keep(self.twice, self.once), once)
        return self._replace(moved=moved, once=once, twice=twice)

    def measured(
        self, i: int, column: ca.SX, update: Update, lasts: ca.SX | float = 1.0
    ) -> "Onset":
        """The onsets after one more measurement.

        Args:
            i: index of the drive.
            column: of the load, twice filtered.
            lasts: for each onset, 1 while the change lasts, 0 once estimates contain it, −1 where
                they contain a load that is absent.
        """
        G = (column[i] * lasts - self.twice[i, :] - update.row @ self.moved) * update.counts
        share = G / update.variance
        return self._replace(
            moved=self.moved + update.gain @ G,
            evidence=self.evidence + share * update.innovation,
            information=self.information + share * G,
        )

    @property
    def score(self) -> ca.SX:
        """Score D / √C of a change."""
        return self.evidence / ca.sqrt(self.information + 1e-12)

    @property
    def size(self) -> ca.SX:
        """Size Δ of the change."""
        return self.evidence / (self.information + 1.0)

    def candidate(self, j: int) -> "Onset":
        """Onset j of all candidates."""
        return Onset(*(part[:, j] for part in self))


@dataclass(frozen=True, eq=False)
class Onsets:
    """All candidate onsets.

    Attributes:
        each: sums since each onset; the last column is for no change since the gripper's signal.
        symbols: of the state.
        open_: 1 while the onset is undecided (`grips`).
        ages: time since each onset [s].
        step: between onsets [s].
        ends: whether an onset is replaced after this cycle.
        clock: cycles since the first one began, after this one.
    """

    each: Onset
    symbols: Onset
    open_: ca.SX
    ages: ca.SX
    step: float
    ends: ca.SX
    clock: ca.SX

    @classmethod
    def before(
        cls, fields: CycleFields, stays: ca.SX, dof: int, lowpass: Lowpass, period: float
    ) -> "Onsets":
        """The onsets from the state of the previous cycle.

        Args:
            stays: share of each estimate that is kept over a cycle.
        """
        count, doc = round((SOON + _SHORT_LIFE) / EVERY), "times at which the load may have changed"
        sizes = zip(Onset._fields, (stays.numel(), 1, 1, dof, dof), strict=True)
        *parts, clock = fields.keep(
            *(Field(f"onset_{name}", size * (count + 1), doc) for name, size in sizes),
            Field("onset_clock", 1, doc),
        )
        symbols = Onset(*(ca.reshape(part, -1, count + 1) for part in parts))
        turn = max(1, int(np.ceil(EVERY / period - 1e-6)))
        later = ca.if_else(clock + 1.5 > turn * count, 0.0, clock + 1)
        cycles = clock - turn * ca.DM(range(count)).T
        ages = ca.if_else(cycles > 0.5, cycles, cycles + turn * count) * period
        each, ends = symbols.later(lowpass, stays), ca.fabs(cycles) < 0.5
        return cls(each, symbols, ca.SX(0), ages, turn * period, ends, later)

    def measured(self, i: int, column: ca.SX, update: Update) -> "Onsets":
        """All onsets after one more measurement."""
        lasts = ca.horzcat(ca.repmat(1 - self.open_, 1, self.ages.numel()), -self.open_)
        return replace(self, each=self.each.measured(i, column, update, lasts))

    @property
    def unsignalled(self) -> list[tuple[Onset, ca.SX]]:
        """Onsets of an unsignalled change, spaced by the memory of unmodelled torques, each with 1
        if it is recent."""
        places = range(0, self.ages.numel(), round(UNMODELLED / EVERY))
        return [(self.each.candidate(j), self.ages[j] < _SHORT_LIFE) for j in places]

    @property
    def likeliest(self) -> Onset:
        """The onset with the largest score."""
        best, most = self.each.candidate(0), ca.SX(-1)
        for onset, recent in self.unsignalled:
            score = ca.if_else(recent, ca.fabs(onset.score), -1.0)
            pairs = zip(onset, best, strict=True)
            best = Onset(*(ca.if_else(score > most, *pair) for pair in pairs))
            most = ca.fmax(score, most)
        return best

    def follow(
        self, fields: CycleFields, change: "Change", closes: ca.SX, once: ca.SX, twice: ca.SX
    ) -> None:
        """Set the state of the next cycle.

        An expired onset begins anew. While the onset is undecided, it begins with the column for no
        change. The gripper's signal ends all onsets.

        Args:
            change: of the load.
            closes: 1 in the cycle in which the onset is decided.
            once, twice: the load's column, filtered.
        """
        count, waits = self.ages.numel(), self.each.candidate(self.ages.numel())
        signalled = ca.logic_and(change.signalled, ca.logic_not(self.open_))
        stays = (1 - closes) * (1 - change.changed)
        filtered, kept = {"once": once, "twice": twice}, ca.fmax(stays, signalled * (1 - closes))
        for name, now in zip(Onset._fields, self.each, strict=True):
            begun, of_signal, anew = getattr(waits, name) * self.open_, kept, ca.SX(0)
            if name in filtered:
                begun, of_signal = filtered[name], stays
                anew = closes * (1 - change.changed) * begun
            each = [ca.if_else(self.ends[j], begun, now[:, j]) for j in range(count)]
            each = [part * of_signal + anew for part in each]
            last = now[:, count] * stays * self.open_
            fields.following[f"onset_{name}"] = ca.vec(ca.densify(ca.horzcat(*each, last)))
        fields.following["onset_clock"] = self.clock


# Least share of a load that remains after a partial release; less counts as a full release.
_LEFT = 0.6
# Share of the largest load below which a load that is not significant counts as none.
_SMALL = 0.05
# Variance of a newly detected load: factor of 1/C, relative deviation in addition, and share of the
# mass's prior variance; its onset is a guess, and filters have hardly responded yet.
_WIDER, _ROUGH, _FREE = 4.0, 0.5, 0.05


@dataclass(frozen=True, eq=False)
class Change:
    """State of the load after a cycle: 1 where it changed, where one is held, where the gripper
    signalled the change, and where residuals showed it."""

    changed: ca.SX
    held: ca.SX
    signalled: ca.SX
    detected: ca.SX


def judge_change(
    fields: CycleFields, seen: Onset, gripper: ca.SX, differs: ca.SX, mass: ca.SX,
    spread: ca.SX, least: float, settings: OnlineSettings,
) -> Change:  # fmt: skip
    """Decide whether the load changes.

    Args:
        gripper: 1 holds, 0 empty, -1 unknown.
        differs: 1 where the gripper's signal differs from the state.
        mass, spread: of the load held, in units of the largest mass.
        least: least mass that is detected, in the same units.
    """
    held, waited, alert = (fields.before[name] for name in ("held", "waited", "alert"))
    silent, wanted = gripper <= -0.5, gripper > 0.5
    waiting = ca.if_else(differs, waited + settings.period, 0)
    by_gripper = ca.logic_and(differs, waiting > settings.grip_time)
    score, size = seen.score, seen.size
    more = every(silent, score > settings.alarm, size > least)
    less = every(silent, score < -settings.alarm, size < -least, held)
    alerted = ca.if_else(ca.logic_or(more, less), alert + settings.period, 0)
    sure = alerted > 1 / settings.corner  # one time constant, until the filter has responded
    more, less = ca.logic_and(more, sure), ca.logic_and(less, sure)
    small = ca.logic_and(mass < 2 * spread, mass + 2 * spread < ca.fmax(least, _SMALL))
    nothing = every(held, silent, small)
    partly = ca.logic_and(less, mass + size > ca.fmax(_LEFT * mass, least))
    now = ca.if_else(ca.logic_or(nothing, less), partly, ca.logic_or(held, more))
    now = ca.if_else(by_gripper, wanted, ca.if_else(silent, now, held))
    changed = ca.logic_or(by_gripper, ca.logic_or(more, ca.logic_or(less, nothing)))
    fields.following |= {
        "held": now,
        "waited": waiting * (1 - by_gripper),
        "alert": alerted * (1 - sure),
    }
    return Change(changed, now, by_gripper, ca.logic_or(more, less))


def estimate_after(estimate: Estimate, seen: Onset, change: Change, n_load: int) -> Estimate:
    """Estimates after a cycle in which the load may have changed.

    After a gripper's signal nothing is known of a new load. A change detected in residuals begins
    with the estimated mass, and its effect on the other estimates is removed:

        x ← x − F Δ,   P ← P + F Fᵀ / C.
    """
    n, by_itself = estimate.x.numel(), change.detected
    none = ca.SX.zeros(n - n_load)
    mass = ca.fmax(estimate.x[0] + (1 - seen.moved[0]) * seen.size, 0) * by_itself * change.held
    variance = _WIDER / (seen.information + 1.0) + (_ROUGH * seen.size) ** 2
    others = ca.vertcat(ca.SX(n_load, 1), seen.moved[n_load:]) * by_itself
    first = ca.vertcat(change.held * by_itself, ca.SX(n - 1, 1))
    along = ca.densify(first - others) * ca.sqrt(variance)
    kept = 1 - ca.vertcat(ca.SX.ones(n_load), none) * change.changed
    x = estimate.x * kept - others * seen.size + first * mass
    fresh = ca.vertcat(change.signalled + _FREE * change.detected, ca.SX.ones(n_load - 1), none)
    fresh *= change.changed * change.held
    P = estimate.P * (kept @ kept.T) + ca.diag(fresh) + along @ along.T
    return Estimate(x, ca.tril2symm(ca.tril(P)))
