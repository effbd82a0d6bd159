"""When a load was taken or left: told by the gripper, or found by itself.

A load that changes by Δ at a time θ moves the filter's innovations by G Δ and its estimates by F Δ,

    G = ψ − h F,   F ← F + gain · G,   F = 0 at θ,

for a measurement with the row h that shows the change by ψ: by the load's filtered column, less
what the filters remember of it from before θ, when nothing was there. Innovations ν are white with
variances s as long as nothing changed, so

    D = Σ G ν / s,   C = Σ G² / s,   score D / √C,   Δ = D / C  with variance 1 / C

is the likelihood ratio of a change at θ, whatever the filter has made of it since (Willsky and
Jones). A few times θ are kept in turn, so memory and work are bounded. When one is believed, what
the change did to the other estimates is taken back, and the load begins with Δ.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from deltaid.online.graph import CycleFields, Field, every
from deltaid.online.kalman import Estimate, Update
from deltaid.online.momentum import Lowpass
from deltaid.online.settings import OnlineSettings

# Times of onset are kept every so many seconds, over so long: a gripper's signal may be as late and
# the load of an early one shows within the rest (`grips`).
_EVERY, _LIFE = 0.01, 0.35
# Where no gripper tells, one of so many counts, for so long [s].
_UNTOLD_EVERY, _UNTOLD_LIFE = 5, 0.15


class Onset(NamedTuple):
    """What would have happened since one time θ, or since several, each in a column: F, D, C, and
    what the filter of the load's column remembers from before θ, and the filter behind it."""

    moved: ca.SX
    evidence: ca.SX
    information: ca.SX
    once: ca.SX
    twice: ca.SX

    def later(self, lowpass: Lowpass, stays: ca.SX) -> "Onset":
        """The same times, seen from a cycle later.

        Args:
            stays: share of each estimate that is not forgotten in a cycle.
        """
        once, moved = lowpass.a * self.once, self.moved * ca.repmat(stays, 1, self.moved.shape[1])
        twice = lowpass.output(lowpass.keep(self.twice, self.once), once)
        return self._replace(moved=moved, once=once, twice=twice)

    def measured(
        self, i: int, column: ca.SX, update: Update, lasts: ca.SX | float = 1.0
    ) -> "Onset":
        """With one measurement more.

        Args:
            i: which drive's.
            column: of the load, twice filtered.
            lasts: of each time, 1 while the change lasts, 0 once estimates know it, −1 where they
                have what is not there.
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
        """One of several times."""
        return Onset(*(part[:, j] for part in self))


@dataclass(frozen=True, eq=False)
class Onsets:
    """All times that are kept.

    Attributes:
        each: what happened since each, and last what did not since the gripper's signal.
        symbols: of the state.
        open_: 1 while that is open (`grips`).
        ages: how long ago each was [s].
        step: from one to the next [s].
        ends: whether one is over after this cycle, and begins anew.
        clock: cycles since the first began, behind this one.
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
        """As the cycle before left them.

        Args:
            stays: share of each estimate that is not forgotten in a cycle.
        """
        count, doc = round(_LIFE / _EVERY), "times at which the load may have changed"
        sizes = zip(Onset._fields, (stays.numel(), 1, 1, dof, dof), strict=True)
        *parts, clock = fields.keep(
            *(Field(f"onset_{name}", size * (count + 1), doc) for name, size in sizes),
            Field("onset_clock", 1, doc),
        )
        symbols = Onset(*(ca.reshape(part, -1, count + 1) for part in parts))
        turn = max(1, int(np.ceil(_EVERY / period - 1e-6)))
        later = ca.if_else(clock + 1.5 > turn * count, 0.0, clock + 1)
        cycles = clock - turn * ca.DM(range(count)).T
        ages = ca.if_else(cycles > 0.5, cycles, cycles + turn * count) * period
        each, ends = symbols.later(lowpass, stays), ca.fabs(cycles) < 0.5
        return cls(each, symbols, ca.SX(0), ages, turn * period, ends, later)

    def measured(self, i: int, column: ca.SX, update: Update) -> "Onsets":
        """With one measurement more."""
        lasts = ca.horzcat(ca.repmat(1 - self.open_, 1, self.ages.numel()), -self.open_)
        return replace(self, each=self.each.measured(i, column, update, lasts))

    @property
    def untold(self) -> list[tuple[Onset, ca.SX]]:
        """Times of a change that no gripper tells of: each, and 1 if it is recent."""
        places = range(0, self.ages.numel(), _UNTOLD_EVERY)
        return [(self.each.candidate(j), self.ages[j] < _UNTOLD_LIFE) for j in places]

    @property
    def likeliest(self) -> Onset:
        """The one with the largest score."""
        best, most = self.each.candidate(0), ca.SX(-1)
        for onset, recent in self.untold:
            score = ca.if_else(recent, ca.fabs(onset.score), -1.0)
            pairs = zip(onset, best, strict=True)
            best = Onset(*(ca.if_else(score > most, *pair) for pair in pairs))
            most = ca.fmax(score, most)
        return best

    def follow(
        self, fields: CycleFields, change: "Change", closes: ca.SX, once: ca.SX, twice: ca.SX
    ) -> None:
        """What the fields of the state become.

        A time that is over begins anew. While it is open when a load was taken or left, a time
        begins with what did not happen before. The gripper's signal ends all of them.

        Args:
            change: of the load.
            closes: 1 where it was open until now when it was taken or left.
            once, twice: the load's column, filtered.
        """
        count, waits = self.ages.numel(), self.each.candidate(self.ages.numel())
        told = ca.logic_and(change.told, ca.logic_not(self.open_))
        stays = (1 - closes) * (1 - change.changed)
        filtered, kept = {"once": once, "twice": twice}, ca.fmax(stays, told * (1 - closes))
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


# Of the load held, what may be left after a release.
_LEFT = 0.6
# A change must be likely for so long, in time constants of the filter: it does not show all of it
# at first.
_CONFIRMED = 1.0
# A load that may be none, and is surely less than this share of the largest, is none.
_SMALL = 0.05
# The variance of what a change begins with is larger than 1/C by this factor, and by the square of
# this share of it: its onset is a guess, and of a load that is taken while the robot moves filters
# show little at first. So it is nearly free as well, by this share of the mass's prior variance.
_WIDER, _ROUGH, _FREE = 4.0, 0.5, 0.05


@dataclass(frozen=True, eq=False)
class Change:
    """What is held behind a cycle: 1 where it is another load, or none, from now on, where one is
    held, where the gripper told the change, and where it was found in residuals."""

    changed: ca.SX
    held: ca.SX
    told: ca.SX
    seen: ca.SX


def gripper_differs(held: ca.SX, gripper: ca.SX) -> ca.SX:
    """1 where the gripper has told something else than what is held."""
    return ca.logic_and(gripper > -0.5, (gripper > 0.5) != held)


def judge_change(
    fields: CycleFields, seen: Onset, gripper: ca.SX, mass: ca.SX, spread: ca.SX,
    least: float, settings: OnlineSettings,
) -> Change:  # fmt: skip
    """Whether the load changes.

    Args:
        gripper: 1 holds, 0 empty, -1 not told.
        mass, spread: of the load held, in units of the largest mass.
        least: mass that is looked for, in the same units.
    """
    held, waited, alert = (fields.before[name] for name in ("held", "waited", "alert"))
    silent, wanted, differs = gripper <= -0.5, gripper > 0.5, gripper_differs(held, gripper)
    waiting = ca.if_else(differs, waited + settings.period, 0)
    by_gripper = ca.logic_and(differs, waiting > settings.grip_time)
    score, size = seen.score, seen.size
    more = every(silent, score > settings.alarm, size > least)
    less = every(silent, score < -settings.alarm, size < -least, held)
    alerted = ca.if_else(ca.logic_or(more, less), alert + settings.period, 0)
    sure = alerted > _CONFIRMED / settings.corner
    more, less = ca.logic_and(more, sure), ca.logic_and(less, sure)
    small = ca.logic_and(mass < 2 * spread, mass + 2 * spread < ca.fmax(least, _SMALL))
    nothing = every(held, silent, small)
    left = ca.logic_and(less, mass + size > ca.fmax(_LEFT * mass, least))
    now = ca.if_else(ca.logic_or(nothing, less), left, ca.logic_or(held, more))
    now = ca.if_else(by_gripper, wanted, ca.if_else(silent, now, held))
    changed = ca.logic_or(by_gripper, ca.logic_or(more, ca.logic_or(less, nothing)))
    fields.following |= {
        "held": now,
        "waited": waiting * (1 - by_gripper),
        "alert": alerted * (1 - sure),
    }
    return Change(changed, now, by_gripper, ca.logic_or(more, less))


def estimate_after(estimate: Estimate, seen: Onset, change: Change, n_load: int) -> Estimate:
    """Estimates behind a cycle in which the load may have changed.

    Told by the gripper, nothing is known of a new load. Found by itself, it begins with the mass
    that was found, and what the change had done to the other estimates is taken back:

        x ← x − F Δ,   P ← P + F Fᵀ / C.
    """
    n, by_itself, none = estimate.x.numel(), change.seen, ca.SX.zeros(estimate.x.numel() - n_load)
    mass = ca.fmax(estimate.x[0] + (1 - seen.moved[0]) * seen.size, 0) * by_itself * change.held
    variance = _WIDER / (seen.information + 1.0) + (_ROUGH * seen.size) ** 2
    others = ca.vertcat(ca.SX(n_load, 1), seen.moved[n_load:]) * by_itself
    first = ca.vertcat(change.held * by_itself, ca.SX(n - 1, 1))
    along = ca.densify(first - others) * ca.sqrt(variance)
    kept = 1 - ca.vertcat(ca.SX.ones(n_load), none) * change.changed
    x = estimate.x * kept - others * seen.size + first * mass
    fresh = ca.vertcat(change.told + _FREE * change.seen, ca.SX.ones(n_load - 1), none)
    fresh *= change.changed * change.held
    P = estimate.P * (kept @ kept.T) + ca.diag(fresh) + along @ along.T
    return Estimate(x, ca.tril2symm(ca.tril(P)))
