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

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import casadi as ca

from deltaid.online.graph import Field, StateField
from deltaid.online.kalman import Estimate, Update
from deltaid.online.momentum import Lowpass
from deltaid.online.settings import OnlineSettings

# How many times of onset are kept, and how long each [s].
_ONSETS, _LIFE = 3, 0.15
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
class Onset:
    """What would have happened since one time θ.

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

    def later(self, lowpass: Lowpass) -> "Onset":
        """The same time, seen from a cycle later."""
        once = lowpass.a * self.once
        twice = lowpass.output(lowpass.keep(self.twice, self.once), once)
        return replace(self, once=once, twice=twice)

    def measured(self, i: int, column: ca.SX, update: Update) -> "Onset":
        """With one measurement more.

        Args:
            i: which drive's.
            column: of the load, twice filtered.
        """
        G = column[i] - self.twice[i] - update.row @ self.moved
        share = G / update.variance
        return replace(
            self,
            moved=self.moved + update.gain * G,
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

    def __iter__(self) -> Iterator[ca.SX]:
        return (getattr(self, name) for name in _NAMES)


_NAMES = tuple(field.name for field in fields(Onset))


@dataclass(frozen=True, eq=False)
class Onsets:
    """All times that are kept.

    Attributes:
        each: what happened since each.
        symbols: of the state.
        ends: whether one is over after this cycle, and begins anew.
        clock: cycles since the first began.
    """

    each: tuple[Onset, ...]
    symbols: tuple[Onset, ...]
    ends: tuple[ca.SX, ...]
    clock: tuple[ca.SX, ca.SX]

    @classmethod
    def named(cls, n: int, dof: int, lowpass: Lowpass, period: float) -> "Onsets":
        """New symbols.

        Args:
            n: how many states are estimated.
        """
        sizes = dict(zip(_NAMES, (n, 1, 1, dof, dof), strict=True))
        symbols = tuple(
            Onset(**{name: ca.SX.sym(f"{name}{j}", size) for name, size in sizes.items()})
            for j in range(_ONSETS)
        )
        clock, turn = ca.SX.sym("clock"), max(1, round(_LIFE / period / _ONSETS))
        later = ca.if_else(clock + 1.5 > turn * _ONSETS, 0.0, clock + 1)
        ends = tuple(ca.fabs(clock - j * turn) < 0.5 for j in range(_ONSETS))
        each = tuple(onset.later(lowpass) for onset in symbols)
        return cls(each, symbols, ends, (clock, later))

    def measured(self, i: int, column: ca.SX, update: Update) -> "Onsets":
        """With one measurement more."""
        return replace(self, each=tuple(onset.measured(i, column, update) for onset in self.each))

    @property
    def likeliest(self) -> Onset:
        """The one with the largest score."""
        best = self.each[0]
        for onset in self.each[1:]:
            best = onset.chosen(ca.fabs(onset.score) > ca.fabs(best.score), best)
        return best

    def kept(self, anew: ca.SX, once: ca.SX, twice: ca.SX) -> tuple[StateField, ...]:
        """Fields of the state.

        Args:
            anew: 1 where filters begin anew.
            once, twice: the load's column, filtered.
        """
        doc, fields = "times at which the load may have changed", list[StateField]()
        for j, (onset, symbol, ends) in enumerate(
            zip(self.each, self.symbols, self.ends, strict=True)
        ):
            begun = Onset(ca.SX(onset.moved.numel(), 1), ca.SX(1, 1), ca.SX(1, 1), once, twice)
            following = onset.chosen(ca.logic_not(ends), begun)
            for name, before, now in zip(_NAMES, symbol, following, strict=True):
                field = Field(f"onset{j + 1}_{name}", before.numel(), doc)
                fields.append(StateField(field, before, ca.densify(now) * (1 - anew)))
        clock, later = self.clock
        return (*fields, StateField(Field("onset_clock", 1, doc), clock, later))


@dataclass(frozen=True, eq=False)
class Change:
    """What is held behind a cycle.

    Attributes:
        changed: 1 where it is another load, or none, from now on.
        held: 1 while a load is held.
        told: 1 where the gripper told the change.
        seen: 1 where the change was found in residuals.
        kept: fields of the state.
    """

    changed: ca.SX
    held: ca.SX
    told: ca.SX
    seen: ca.SX
    kept: tuple[StateField, ...]


def gripper_differs(held: ca.SX, gripper: ca.SX) -> ca.SX:
    """1 where the gripper has told something else than what is held."""
    return ca.logic_and(gripper > -0.5, (gripper > 0.5) != held)


def judge_change(
    seen: Onset,
    held: ca.SX,
    gripper: ca.SX,
    mass: ca.SX,
    spread: ca.SX,
    least: float,
    settings: OnlineSettings,
) -> Change:
    """Whether the load changes.

    Args:
        held: 1 where a load was held in the cycle before.
        gripper: 1 holds, 0 empty, -1 not told.
        mass, spread: of the load held, in units of the largest mass.
        least: mass that is looked for, in the same units.
    """
    waited, alert = ca.SX.sym("waited"), ca.SX.sym("alert")
    silent, wanted, differs = gripper <= -0.5, gripper > 0.5, gripper_differs(held, gripper)
    waiting = ca.if_else(differs, waited + settings.period, 0)
    by_gripper = ca.logic_and(differs, waiting > settings.grip_time)
    score, size = seen.score, seen.size
    more = ca.logic_and(silent, ca.logic_and(score > settings.alarm, size > least))
    less = ca.logic_and(silent, ca.logic_and(score < -settings.alarm, size < -least))
    less = ca.logic_and(less, held)
    alerted = ca.if_else(ca.logic_or(more, less), alert + settings.period, 0)
    sure = alerted > _CONFIRMED / settings.corner
    more, less = ca.logic_and(more, sure), ca.logic_and(less, sure)
    small = ca.logic_and(mass < 2 * spread, mass + 2 * spread < ca.fmax(least, _SMALL))
    nothing = ca.logic_and(ca.logic_and(held, silent), small)
    left = ca.logic_and(less, mass + size > ca.fmax(_LEFT * mass, least))
    now = ca.if_else(ca.logic_or(nothing, less), left, ca.logic_or(held, more))
    now = ca.if_else(by_gripper, wanted, ca.if_else(silent, now, held))
    changed = ca.logic_or(by_gripper, ca.logic_or(more, ca.logic_or(less, nothing)))
    since = Field("waited", 1, "time since the gripper's signal", "s")
    kept = (
        StateField(Field("held", 1, "1 while a load is held"), held, now),
        StateField(since, waited, waiting * (1 - by_gripper)),
        StateField(
            Field("alert", 1, "time for which a change was likely", "s"),
            alert,
            alerted * (1 - sure),
        ),
    )
    return Change(changed, now, by_gripper, ca.logic_or(more, less), kept)


def estimate_after(estimate: Estimate, seen: Onset, change: Change, n_load: int) -> Estimate:
    """Estimates behind a cycle in which the load may have changed.

    Told by the gripper, nothing is known of a new load. Found by itself, it begins with the mass
    that was found, and what the change had done to the other estimates is taken back:

        x ← x − F Δ,   P ← P + F Fᵀ / C.
    """
    n = estimate.x.numel()
    mine = ca.vertcat(ca.SX.ones(n_load), ca.SX.zeros(n - n_load))
    by_itself = change.seen
    mass = ca.fmax(estimate.x[0] + (1 - seen.moved[0]) * seen.size, 0) * by_itself * change.held
    variance = _WIDER / (seen.information + 1.0) + (_ROUGH * seen.size) ** 2
    others = ca.vertcat(ca.SX(n_load, 1), seen.moved[n_load:]) * by_itself
    first = ca.vertcat(change.held * by_itself, ca.SX(n - 1, 1))
    along = ca.densify(first - others) * ca.sqrt(variance)
    x = estimate.x * (1 - mine * change.changed) - others * seen.size + first * mass
    kept = 1 - mine * change.changed
    own = change.told + _FREE * change.seen
    fresh = ca.vertcat(own, ca.SX.ones(n_load - 1), ca.SX.zeros(n - n_load))
    fresh = fresh * (change.changed * change.held)
    P = estimate.P * (kept @ kept.T) + ca.diag(fresh) + along @ along.T
    return Estimate(x, ca.tril2symm(ca.tril(P)))
