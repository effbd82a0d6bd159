"""Settings of drift, and the finding on one drive: steady, rising, falling or stepped, with onset,
rate and horizon.

Distributions are mixtures of Student's over kinds of scatter and onsets; intervals are quantiles of
draws.
"""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr, stdtr, stdtrit

from deltaid.errors import DeltaidError, counted
from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.drift_evidence import FEWEST, KINDS, MONTH, WEEK, YEAR
from deltaid.fleets.drift_series import Explained

State = Literal["steady", "rising", "falling", "stepped", "unknown"]
# Least time for the finding steady, with `FEWEST` recordings, and for an alarm [days]: within less
# time, gears that warm up look like a change.
_STEADY, _WARMING = 3 * WEEK, 3.0
# Half width of a rate's interval from which the rate is unknown [% a month].
_VAGUE = 5.0
# Number of draws that quantiles are taken from.
_DRAWS = 4000
# Longest reported horizon [years].
_FAR = 20.0


@dataclass(frozen=True)
class DriftSettings:
    """Settings of the search for drift.

    Attributes:
        limit: of friction, as a ratio to its value before the change (1.5) or as a mean torque
            [N m or N]; None for no limit.
        limit_is: whether the limit is a ratio, 'share', or a torque.
        false_alarms: accepted rate per robot-year, over all of its drives.
        since: start; earlier recordings, such as those before a repair, are excluded.
    """

    limit: float | None = None
    limit_is: Literal["share", "torque"] = "share"
    false_alarms: float = 0.1
    since: datetime | None = None

    def __post_init__(self) -> None:
        """Refuse impossible limits and rates.

        Raises:
            DeltaidError: the limit is exceeded already, or the rate is not above 0 and at most 10.
        """
        lowest = 1.0 if self.limit_is == "share" else 0.0
        if self.limit is not None and not self.limit > lowest:
            raise DeltaidError(
                f"must be above {lowest:g}, not {self.limit:g}",
                where="limit",
                cure="give a share of the friction before the change, such as 1.5, or a torque",
            )
        if not 0.0 < self.false_alarms <= 10.0:
            raise DeltaidError(
                f"must be above 0 and at most 10, not {self.false_alarms:g}",
                where="false_alarms",
                cure="give how many false alarms a robot may have in a year, such as 0.1",
            )


@dataclass(frozen=True)
class Between:
    """A number with its 95 % interval; None for unknown values."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class DriftFinding:
    """The finding on one drive.

    Attributes:
        change: day of the change, if any.
        rate: of friction, as a share per month.
        step: of friction, as a share.
        horizon: day on which the limit is reached, if known and near.
        temperature: change of friction with temperature, as a share per degree.
        level: mean friction before the change, at the mean temperature [N m or N]; NaN if
            undetermined.
        limit: of mean friction [N m or N]; None for no limit.
        recordings: number of recordings that determine its friction.
        scatter: from day to day, as a share.
        R: statistic of the alarm, which starts at `threshold` [years].
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
    """Draws of a change: its kind, the kind of scatter, its onset, its size."""

    kind: Int[np.ndarray, " draws"]
    scatter: Int[np.ndarray, " draws"]
    at: Int[np.ndarray, " draws"]
    size: Float[np.ndarray, " draws"]


def finding(series: Explained, drive: int, settings: DriftSettings, drives: int) -> DriftFinding:
    threshold = drives / settings.false_alarms
    R, recorded = float(series.evidence.R[drive]), np.isfinite(series.y[drive])
    count = int(recorded.sum())
    span = float(np.ptp(series.days[recorded])) if count else 0.0
    alarm = threshold <= R and span >= _WARMING
    too_few = not alarm and (count < FEWEST or span < _STEADY)
    draws, state = _drawn(series, drive, alarm=alarm), "steady"
    if alarm:
        state, draws = _likeliest(draws)
    b = _coefficients(series, drive, draws)
    level = float(np.exp((series.start[drive] + np.median(b[:, 0])) / 100.0)) if count else np.nan
    limit = settings.limit if count else None
    if limit is not None and settings.limit_is == "share":
        limit *= level
    middle, low, high = _between(np.expm1(draws.size / 100.0))
    shares = Between(middle, low, high)
    rate = Between() if too_few or state == "stepped" else shares
    if too_few or (not alarm and 50.0 * (high - low) > _VAGUE):
        state = "unknown"
    # Onsets are uniform between the candidates.
    u = np.random.default_rng(2).uniform(-0.5, 0.5, len(draws.at)) * series.changes.years * YEAR
    onsets = np.clip(series.changes.onsets[draws.at] + u, series.days[0], series.days[-1])
    horizon, note = _horizon(series, draws, state, level, limit, b)
    temperature, names = Between(), series.regressors.names
    if "temperature" in names and not too_few:
        temperature = Between(*_between(b[:, names.index("temperature")] / 100.0))
    return DriftFinding(
        state=state,
        change=Between(*_between(onsets)) if alarm else Between(),
        rate=rate,
        step=shares if state == "stepped" else Between(),
        horizon=horizon,
        temperature=temperature,
        level=level,
        limit=limit,
        recordings=count,
        scatter=float(series.evidence.of_kinds[:, drive] @ series.evidence.sigma[:, drive]) / 100.0,
        R=R,
        threshold=threshold,
        reason=_reason(state, too_few, count, span, series, rate, note),
    )


def _drawn(series: Explained, drive: int, *, alarm: bool) -> _Draws:
    """Draws of changes; without an alarm, of a trend over the whole time, with either sign."""
    rng, evidence = np.random.default_rng(0), series.evidence
    nu = evidence.freedom[drive]
    shares = evidence.of_changes[:, :, drive] if alarm else evidence.of_kinds[None, :, [drive]]
    flat = rng.choice(shares.size, _DRAWS, p=shares.ravel() / shares.sum())
    down, kinds, at = np.unravel_index(flat, shares.shape)
    m, s = evidence.size[kinds, drive, at], evidence.deviation[kinds, drive, at]
    u = rng.uniform(size=_DRAWS)
    if alarm:  # the sign is known
        edge = stdtr(nu, -m / s)
        u = np.where(down, u * edge, edge + u * (1.0 - edge))
    size = m + s * stdtrit(nu, np.clip(u, 1e-12, 1.0 - 1e-12))
    down = down if alarm else size <= 0
    return _Draws(down + 2 * ~series.changes.is_ramp[at], kinds, at, size)


def _likeliest(draws: _Draws) -> tuple[State, _Draws]:
    names = np.array([name for name, _ in KINDS])[draws.kind]
    states: tuple[State, ...] = ("rising", "falling", "stepped")
    state = max(states, key=lambda name: np.mean(names == name))
    kept = names == state
    return state, _Draws(draws.kind[kept], draws.scatter[kept], draws.at[kept], draws.size[kept])


def _coefficients(series: Explained, drive: int, draws: _Draws) -> Float[np.ndarray, "draws own"]:
    evidence, rng = series.evidence, np.random.default_rng(1)
    plain = evidence.plain[draws.scatter, drive]
    per_size = evidence.per_size[draws.scatter, drive, :, draws.at]
    root = np.linalg.cholesky(evidence.covariance[:, drive])
    noise = np.einsum("npq,nq->np", root[draws.scatter], rng.standard_normal(plain.shape))
    return plain - per_size * draws.size[:, None] + noise


def _between(values: Float[np.ndarray, " draws"]) -> list[float]:
    return np.quantile(values, ndtr([0.0, -NORMAL, NORMAL])).tolist()


def _horizon(
    series: Explained,
    draws: _Draws,
    state: State,
    level: float,
    limit: float | None,
    b: Float[np.ndarray, "draws own"],
) -> tuple[Between, str]:
    last, passed = float(series.days[-1]), "the limit is passed"
    if limit is None:
        return Between(), "no limit was given" if state == "rising" else ""
    if state == "stepped" and level * float(np.exp(np.median(draws.size) / 100.0)) >= limit:
        return Between(last), passed
    if state != "rising":
        return Between(), ""
    spread = (b[:, 0] - np.median(b[:, 0])) / 100.0
    months = (np.log(limit / level) - spread) / np.maximum(draws.size / 100.0, 1e-9)
    far = last + _FAR * YEAR
    when = np.minimum(series.changes.onsets[draws.at] + MONTH * months, far + _FAR * YEAR)
    middle, low, high = _between(when)
    if middle > far:
        return Between(), f"the limit is more than {_FAR:.0f} years away"
    return Between(middle, low, high if high <= far else None), passed if middle <= last else ""


def _reason(
    state: State, few: bool, count: int, span: float, series: Explained, rate: Between, note: str
) -> str:
    if not count:
        return "no recording determines its friction"
    if few:
        return (
            f"not enough data: no change in {counted(count, 'recording')} over "
            f"{span:.0f} days; steady needs {FEWEST} over {_STEADY:.0f} days"
        )
    parts = (
        "not enough data: its trend is not known well enough" if state == "unknown" else "",
        f"no change; a trend over all the time lies between {100 * rate.low:+.2g} and "
        f"{100 * rate.high:+.2g} % a month"
        if state == "steady" and rate.low is not None and rate.high is not None
        else "",
        "no temperature is known, so seasons are not taken out"
        if "season" in series.regressors.names
        else "",
        note,
    )
    return "; ".join(filter(None, parts))
