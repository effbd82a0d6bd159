"""What is said of one drive: steady, rising, falling or stepped; since when, how fast, until when.

Distributions are sums over kinds of scatter and onsets of Student's, drawn from as quantiles.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import stdtr, stdtrit

from deltaid.drift.evidence import KINDS, MONTH, YEAR
from deltaid.drift.series import Explained
from deltaid.drift.settings import DriftSettings

State = Literal["steady", "rising", "falling", "stepped", "unknown"]
# Fewer recordings, or over less time [days], say nothing of drift.
FEWEST, SHORTEST = 12, 21.0
# A rate that is known no better than this [% a month] says nothing.
_VAGUE = 5.0
# How many draws, and how much of a distribution an interval has.
_DRAWS, _TAIL = 4000, 0.025
# Beyond so many years no horizon is told.
_FAR = 20.0


@dataclass(frozen=True)
class Between:
    """A number with its 95 % interval; None where an end is not known."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Finding:
    """What is said of one drive.

    Attributes:
        state: what it does.
        change: day of the change; nothing where there is none.
        rate: of friction, as a share a month.
        step: of friction, as a share.
        horizon: day on which the limit is passed; nothing where it is not known, or not near.
        temperature: change of friction with temperature, as a share a degree.
        level: mean friction before the change, at the mean temperature [N m or N]; NaN where no
            recording tells any.
        limit: mean friction that is too much [N m or N]; None if nobody said.
        recordings: how many told something.
        scatter: from day to day, as a share.
        R: what the alarm goes by; `threshold` is where it begins [years].
        reason: in words.
    """

    state: State
    change: Between
    rate: Between
    step: Between
    horizon: Between
    temperature: Between
    level: float
    limit: float | None
    recordings: int
    scatter: float
    R: float
    threshold: float
    reason: str


@dataclass(frozen=True, eq=False)
class _Draws:
    """Draws from what is known of a change: its kind, the kind of scatter, its onset, its size."""

    kind: Int[np.ndarray, " draws"]
    scatter: Int[np.ndarray, " draws"]
    at: Int[np.ndarray, " draws"]
    size: Float[np.ndarray, " draws"]


def finding(one: Explained, drive: int, settings: DriftSettings, drives: int) -> Finding:
    """What the series of a robot say of one of its drives."""
    threshold = drives / settings.false_alarms
    R, there = float(one.found.R[drive]), np.isfinite(one.y[drive])
    count = int(there.sum())
    span = float(np.ptp(one.days[there])) if count else 0.0
    few = count < FEWEST or span < SHORTEST
    alarm = threshold <= R and not few
    draws, state = _drawn(one, drive, alarm=alarm), "steady"
    if alarm:
        state, draws = _likeliest(draws)
    b = _coefficients(one, drive, draws)
    level = float(np.exp((one.start[drive] + np.median(b[:, 0])) / 100.0)) if count else np.nan
    limit = settings.limit if count else None
    if limit is not None and settings.limit_is == "share":
        limit *= level
    middle, low, high = _between(np.expm1(draws.size / 100.0))
    shares = Between(middle, low, high)
    rate = Between() if few or state == "stepped" else shares
    if few or (not alarm and 50.0 * (high - low) > _VAGUE):
        state = "unknown"
    # Changes began anywhere between the onsets that are tried.
    apart = np.random.default_rng(2).uniform(-0.5, 0.5, len(draws.at)) * one.changes.years * YEAR
    onsets = np.clip(one.changes.onsets[draws.at] + apart, one.days[0], one.days[-1])
    horizon, words = _horizon(one, draws, state, level, limit, b)
    temperature, names = Between(), one.regressors.names
    if "temperature" in names and not few:
        temperature = Between(*_between(b[:, names.index("temperature")] / 100.0))
    return Finding(
        state=state,
        change=Between(*_between(onsets)) if alarm else Between(),
        rate=rate,
        step=shares if state == "stepped" else Between(),
        horizon=horizon,
        temperature=temperature,
        level=level,
        limit=limit,
        recordings=count,
        scatter=float(one.found.of_kinds[:, drive] @ one.found.sigma[:, drive]) / 100.0,
        R=R,
        threshold=threshold,
        reason=_reason(state, few, count, span, one, rate, words),
    )


def _drawn(one: Explained, drive: int, *, alarm: bool) -> _Draws:
    """Changes as probable as they are; without an alarm a trend over all the time, either way."""
    rng, found = np.random.default_rng(0), one.found
    nu = found.freedom[drive]
    shares = found.of_changes[:, :, drive] if alarm else found.of_kinds[None, :, [drive]]
    flat = rng.choice(shares.size, _DRAWS, p=shares.ravel() / shares.sum())
    down, kinds, at = np.unravel_index(flat, shares.shape)
    m, s = found.size[kinds, drive, at], found.deviation[kinds, drive, at]
    u = rng.uniform(size=_DRAWS)
    if alarm:  # the sign is known
        edge = stdtr(nu, -m / s)
        u = np.where(down, u * edge, edge + u * (1.0 - edge))
    size = m + s * stdtrit(nu, np.clip(u, 1e-12, 1.0 - 1e-12))
    down = down if alarm else size <= 0
    return _Draws(down + 2 * ~one.changes.is_ramp[at], kinds, at, size)


def _likeliest(draws: _Draws) -> tuple[State, _Draws]:
    """The likeliest state of a drive that changes, and its draws."""
    names = np.array([name for name, _ in KINDS])[draws.kind]
    states: tuple[State, ...] = ("rising", "falling", "stepped")
    state = max(states, key=lambda name: np.mean(names == name))
    own = names == state
    return state, _Draws(draws.kind[own], draws.scatter[own], draws.at[own], draws.size[own])


def _coefficients(one: Explained, drive: int, draws: _Draws) -> Float[np.ndarray, "draws own"]:
    """Coefficients beside the change, drawn with it."""
    found, rng = one.found, np.random.default_rng(1)
    plain = found.plain[draws.scatter, drive]
    per_size = found.per_size[draws.scatter, drive, :, draws.at]
    own = np.linalg.cholesky(found.covariance[:, drive])
    noise = np.einsum("npq,nq->np", own[draws.scatter], rng.standard_normal(plain.shape))
    return plain - per_size * draws.size[:, None] + noise


def _between(values: Float[np.ndarray, " draws"]) -> list[float]:
    """Median, and the ends of the 95 % interval."""
    return np.quantile(values, [0.5, _TAIL, 1.0 - _TAIL]).tolist()


def _horizon(
    one: Explained,
    draws: _Draws,
    state: State,
    level: float,
    limit: float | None,
    b: Float[np.ndarray, "draws own"],
) -> tuple[Between, str]:
    """When the limit is passed, and what is said of it."""
    last, passed = float(one.days[-1]), "the limit is passed"
    if limit is None:
        return Between(), "no limit was given" if state == "rising" else ""
    if state == "stepped" and level * float(np.exp(np.median(draws.size) / 100.0)) >= limit:
        return Between(last), passed
    if state != "rising":
        return Between(), ""
    spread = (b[:, 0] - np.median(b[:, 0])) / 100.0
    months = (np.log(limit / level) - spread) / np.maximum(draws.size / 100.0, 1e-9)
    far = last + _FAR * YEAR
    when = np.minimum(one.changes.onsets[draws.at] + MONTH * months, far + _FAR * YEAR)
    middle, low, high = _between(when)
    if middle > far:
        return Between(), f"the limit is more than {_FAR:.0f} years away"
    return Between(middle, low, high if high <= far else None), passed if middle <= last else ""


def _reason(
    state: State, few: bool, count: int, span: float, one: Explained, rate: Between, words: str
) -> str:
    if not count:
        return "no recording tells its friction"
    if few:
        return (
            f"{count} recordings over {span:.0f} days: at least {FEWEST} over {SHORTEST:.0f} days "
            "are needed"
        )
    parts = list[str]()
    if state == "unknown":
        parts.append("its trend is not known well enough")
    if state == "steady" and rate.low is not None and rate.high is not None:
        parts.append(
            f"no change; a trend over all the time lies between {100 * rate.low:+.2g} and "
            f"{100 * rate.high:+.2g} % a month"
        )
    if "season" in one.regressors.names:
        parts.append("no temperature is known, so seasons are not taken out")
    return "; ".join([*parts, *([words] if words else [])])
