"""What is said of one drive: steady, rising, falling or stepped; since when, how fast, until when.

Distributions are sums over kinds of scatter and onsets of Student's, drawn from as quantiles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
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
    """Draws from what is known of a change."""

    kind: np.ndarray
    scatter: np.ndarray
    at: np.ndarray
    size: np.ndarray


def finding(one: Explained, drive: int, settings: DriftSettings, drives: int) -> Finding:
    """What the series of a robot say of one of its drives."""
    threshold = drives / settings.false_alarms
    R, there = float(one.found.R[drive]), np.isfinite(one.y[drive])
    count = int(there.sum())
    span = float(np.ptp(one.days[there])) if count else 0.0
    few = count < FEWEST or span < SHORTEST
    alarm = threshold <= R and not few
    draws = _drawn(one, drive, alarm=alarm)
    states = [KINDS[k][0] for k in range(len(KINDS))]
    shares = {name: float(np.mean([states[k] == name for k in draws.kind])) for name in states}
    state: State = "steady"
    if alarm:
        state = max(("rising", "falling", "stepped"), key=lambda name: shares[name])
        draws = _of_state(draws, [k for k, name in enumerate(states) if name == state])
    b = _coefficients(one, drive, draws)
    level = float(np.exp((one.start[drive] + np.median(b[:, 0])) / 100.0))
    level = level if count else float("nan")
    limit = _limit(settings, level) if count else None
    change = _between(_onsets(one, draws)) if alarm else Between()
    rate = Between() if few or state == "stepped" else _between(_share(draws.size))
    vague = rate.low is not None and rate.high is not None and (
        50.0 * (rate.high - rate.low) > _VAGUE)  # fmt: skip
    if few or (not alarm and vague):
        state = "unknown"
    horizon, words = _horizon(one, draws, state, level, limit, b)
    step = _between(_share(draws.size)) if state == "stepped" else Between()
    temperature = Between()
    if "temperature" in one.regressors.names and not few:
        temperature = _between(b[:, one.regressors.names.index("temperature")] / 100.0)
    sigma = float(one.found.of_kinds[:, drive] @ one.found.sigma[:, drive])
    reason = _reason(state, few, count, span, one, rate, words)
    return Finding(
        state, change, rate, step, horizon, temperature, level, limit, count,
        sigma / 100.0, R, threshold, reason,
    )  # fmt: skip


def _share(percent: np.ndarray) -> np.ndarray:
    return np.expm1(percent / 100.0)


def _limit(settings: DriftSettings, level: float) -> float | None:
    if settings.limit is None:
        return None
    return settings.limit * level if settings.limit_is == "share" else settings.limit


def _drawn(one: Explained, drive: int, *, alarm: bool) -> _Draws:
    """Changes as probable as they are; without an alarm a trend over all the time, either way."""
    rng, found = np.random.default_rng(0), one.found
    nu = found.freedom[drive]
    if not alarm:
        kinds = rng.choice(found.of_kinds.shape[0], _DRAWS, p=found.of_kinds[:, drive])
        at = np.zeros(_DRAWS, dtype=int)
        m, s = found.size[kinds, drive, at], found.deviation[kinds, drive, at]
        size = m + s * stdtrit(nu, rng.uniform(size=_DRAWS))
        return _Draws(np.where(size > 0, 0, 1), kinds, at, size)
    shares = found.of_changes[:, :, drive]
    flat = rng.choice(shares.size, _DRAWS, p=shares.ravel() / shares.sum())
    way, kinds, at = np.unravel_index(flat, shares.shape)
    m, s = found.size[kinds, drive, at], found.deviation[kinds, drive, at]
    edge, u = stdtr(nu, -m / s), rng.uniform(size=_DRAWS)
    u = np.where(way == 0, edge + u * (1.0 - edge), u * edge)
    size = m + s * stdtrit(nu, np.clip(u, 1e-12, 1.0 - 1e-12))
    return _Draws(way + 2 * ~one.changes.is_ramp[at], kinds, at, size)


def _of_state(draws: _Draws, kinds: Sequence[int]) -> _Draws:
    own = np.isin(draws.kind, kinds)
    return _Draws(draws.kind[own], draws.scatter[own], draws.at[own], draws.size[own])


def _coefficients(one: Explained, drive: int, draws: _Draws) -> Float[np.ndarray, "draws own"]:
    """Coefficients beside the change, drawn with it."""
    found, rng = one.found, np.random.default_rng(1)
    plain = found.plain[draws.scatter, drive]
    per_size = found.per_size[draws.scatter, drive, :, draws.at]
    own = np.array([np.linalg.cholesky(C) for C in found.covariance[:, drive]])
    noise = np.einsum("npq,nq->np", own[draws.scatter], rng.standard_normal(plain.shape))
    return plain - per_size * draws.size[:, None] + noise


def _onsets(one: Explained, draws: _Draws) -> Float[np.ndarray, " draws"]:
    """When changes began: anywhere between the onsets that are tried."""
    u = np.random.default_rng(2).uniform(-0.5, 0.5, size=len(draws.at))
    found = one.changes.onsets[draws.at] + u * one.changes.years * YEAR
    return np.clip(found, one.days[0], one.days[-1])


def _between(values: Float[np.ndarray, " draws"]) -> Between:
    low, middle, high = np.quantile(values, [_TAIL, 0.5, 1.0 - _TAIL]).tolist()
    return Between(middle, low, high)


def _horizon(
    one: Explained,
    draws: _Draws,
    state: State,
    level: float,
    limit: float | None,
    b: Float[np.ndarray, "draws own"],
) -> tuple[Between, str]:
    """When the limit is passed, and what is said of it."""
    last = float(one.days[-1])
    if limit is None:
        return Between(), "no limit was given" if state == "rising" else ""
    if state == "stepped":
        above = level * float(np.exp(np.median(draws.size) / 100.0)) >= limit
        return (Between(last, None, None), "the limit is passed") if above else (Between(), "")
    if state != "rising":
        return Between(), ""
    spread = (b[:, 0] - np.median(b[:, 0])) / 100.0
    months = (np.log(limit / level) - spread) / np.maximum(draws.size / 100.0, 1e-9)
    when = np.minimum(one.changes.onsets[draws.at] + MONTH * months, last + 2 * _FAR * YEAR)
    found = _between(when)
    far = last + _FAR * YEAR
    if found.value is None or found.value > far:
        return Between(), f"the limit is more than {_FAR:.0f} years away"
    high = found.high if found.high is not None and found.high <= far else None
    return Between(
        found.value, found.low, high
    ), "the limit is passed" if found.value <= last else ""


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
    if words:
        parts.append(words)
    return "; ".join(parts)
