"""What a load that changes at a time θ does to the filter and its innovations (`changes`)."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np

from deltaid.online.graph import Field, StateField
from deltaid.online.kalman import Update
from deltaid.online.momentum import Lowpass

# Times of onset are kept every so many seconds, over so long: a gripper's signal may be as late and
# the load of an early one shows within the rest (`grips`).
_EVERY, _LIFE = 0.01, 0.35
# Where no gripper tells, one of so many counts, for so long [s].
_UNTOLD_EVERY, _UNTOLD_LIFE = 5, 0.15


@dataclass(frozen=True, eq=False)
class Onset:
    """What would have happened since one time θ, or since several, each in a column.

    Attributes:
        moved: F.
        evidence, information: D and C.
        once, twice: what the filter of the load's column remembers from before θ, and the filter
            behind it.
    """

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
        once = lowpass.a * self.once
        twice = lowpass.output(lowpass.keep(self.twice, self.once), once)
        moved = self.moved * ca.repmat(stays, 1, self.moved.shape[1])
        return replace(self, moved=moved, once=once, twice=twice)

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
        G = column[i] * lasts - self.twice[i, :] - update.row @ self.moved
        G = G * update.counts
        share = G / update.variance
        return replace(
            self,
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

    def chosen(self, condition: ca.SX, other: "Onset") -> "Onset":
        """This one, or another one."""
        return Onset(*(ca.if_else(condition, a, b) for a, b in zip(self, other, strict=True)))

    def at(self, j: int) -> "Onset":
        """One of several times."""
        return Onset(*(part[:, j] for part in self))

    def __iter__(self) -> Iterator[ca.SX]:
        return (getattr(self, name) for name in _NAMES)


_NAMES = tuple(field.name for field in fields(Onset))


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
        clock: cycles since the first began.
    """

    each: Onset
    symbols: Onset
    open_: ca.SX
    ages: ca.SX
    step: float
    ends: ca.SX
    clock: tuple[ca.SX, ca.SX]

    @classmethod
    def named(cls, stays: ca.SX, dof: int, lowpass: Lowpass, period: float) -> "Onsets":
        """New symbols.

        Args:
            stays: share of each estimate that is not forgotten in a cycle.
        """
        count = round(_LIFE / _EVERY)
        sizes = dict(zip(_NAMES, (stays.numel(), 1, 1, dof, dof), strict=True))
        symbols = Onset(**{name: ca.SX.sym(name, size, count + 1) for name, size in sizes.items()})
        clock, turn = ca.SX.sym("clock"), max(1, int(np.ceil(_EVERY / period - 1e-6)))
        later = ca.if_else(clock + 1.5 > turn * count, 0.0, clock + 1)
        began = turn * ca.DM(range(count)).T
        cycles = clock - began
        ages = ca.if_else(cycles > 0.5, cycles, cycles + turn * count) * period
        each, ends = symbols.later(lowpass, stays), ca.fabs(cycles) < 0.5
        return cls(each, symbols, ca.SX(0), ages, turn * period, ends, (clock, later))

    def measured(self, i: int, column: ca.SX, update: Update) -> "Onsets":
        """With one measurement more."""
        count = self.ages.numel()
        lasts = ca.horzcat(ca.repmat(1 - self.open_, 1, count), -self.open_)
        return replace(self, each=self.each.measured(i, column, update, lasts))

    @property
    def untold(self) -> list[tuple[Onset, ca.SX]]:
        """Times of a change that no gripper tells of: each, and 1 if it is recent."""
        places = range(0, self.ages.numel(), _UNTOLD_EVERY)
        return [(self.each.at(j), self.ages[j] < _UNTOLD_LIFE) for j in places]

    @property
    def likeliest(self) -> Onset:
        """The one with the largest score."""
        best, most = self.each.at(0), ca.SX(-1)
        for onset, recent in self.untold:
            score = ca.if_else(recent, ca.fabs(onset.score), -1.0)
            best, most = onset.chosen(score > most, best), ca.fmax(score, most)
        return best

    def kept(
        self, changed: ca.SX, told: ca.SX, closes: ca.SX, once: ca.SX, twice: ca.SX
    ) -> tuple[StateField, ...]:
        """Fields of the state.

        A time that is over begins anew. While it is open when a load was taken or left, a time
        begins with what did not happen before. The gripper's signal ends all of them.

        Args:
            changed: 1 where another load begins, or none, and
            told: where the gripper told so.
            closes: 1 where that was open until now.
            once, twice: the load's column, filtered.
        """
        doc, fields = "times at which the load may have changed", list[StateField]()
        count, waits, last = self.ages.numel(), self.each.at(self.ages.numel()), list[ca.SX]()
        told = ca.logic_and(told, ca.logic_not(self.open_))
        stays = (1 - closes) * (1 - changed)
        for name, before, now in zip(_NAMES, self.symbols, self.each, strict=True):
            filtered = {"once": once, "twice": twice}.get(name)
            begun = getattr(waits, name) * self.open_ if filtered is None else filtered
            each = [ca.if_else(self.ends[j], begun, now[:, j]) for j in range(count)]
            of_signal = stays if filtered is not None else ca.fmax(stays, told * (1 - closes))
            each = [part * of_signal for part in each]
            if filtered is not None:
                each = [part + closes * (1 - changed) * filtered for part in each]
            last = now[:, count] * stays * self.open_
            following = ca.vec(ca.densify(ca.horzcat(*each, last)))
            field = Field(f"onset_{name}", before.numel(), doc)
            fields.append(StateField(field, ca.vec(before), following))
        clock, later = self.clock
        return (*fields, StateField(Field("onset_clock", 1, doc), clock, later))
