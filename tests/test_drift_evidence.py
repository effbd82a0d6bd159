"""Evidence of changes: against dense formulas, and what it finds and does not find in series."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from deltaid.fleets.drift_evidence import (
    _A_YEAR,
    FREEDOM,
    KINDS,
    MONTH,
    SIZE,
    Changes,
    _moments,
    evidence,
    first_prior,
    with_others,
)
from deltaid.fleets.drift_findings import DriftSettings, finding
from deltaid.fleets.drift_scatter import USUAL_SCATTER, DailyScatter, whitened_sums
from deltaid.fleets.drift_series import Regressors, _slow, explained, inflation
from deltaid.fleets.robot_drift import tool_changes

DAYS = np.sort(np.random.default_rng(5).uniform(0.0, 60.0, 30))


def _covariance(days: np.ndarray, variance: np.ndarray, T: float, share: float) -> np.ndarray:
    apart = np.abs(days[:, None] - days)
    return share * np.exp(-apart / T) + (1 - share) * np.diag(variance)


def _problem(seed: int = 0):
    """Two series with a regressor, one of them with recordings that are missing."""
    rng = np.random.default_rng(seed)
    variance = rng.uniform(0.5, 3.0, (2, len(DAYS)))
    variance[1, [0, 4, 5, 29]] = np.inf
    base = rng.standard_normal((2, len(DAYS), 3))
    base[..., 0] = 1.0
    return (
        variance,
        base,
        DailyScatter(np.array([1.0, 7.0]), np.array([0.0, 0.6]), np.array([0.7, 0.3])),
    )


def test_white_columns_have_the_sums_of_generalised_least_squares() -> None:
    variance, base, scatter = _problem()
    changes = Changes.over(DAYS)
    found = whitened_sums(DAYS, variance, base, changes.columns, scatter)
    for k in range(2):
        for s in range(2):
            there = np.isfinite(variance[s])
            V = _covariance(DAYS[there], variance[s][there], scatter.memory[k], scatter.share[k])
            X, H = base[s][there], changes.columns[there]
            products = X.T @ np.linalg.solve(V, np.hstack([X, H]))
            np.testing.assert_allclose(found.products[k, s], products, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(
                found.squares[k, s],
                np.sum(H * np.linalg.solve(V, H), axis=0),
                rtol=1e-8,
                atol=1e-12,
            )
            np.testing.assert_allclose(found.log_det[k, s], np.linalg.slogdet(V)[1], rtol=1e-9)
            assert found.count[s] == there.sum()


def test_factors_are_ratios_of_marginal_likelihoods() -> None:
    """By Student's density with d and b integrated, and the share of draws with a sign."""
    variance, base, scatter = _problem()
    changes = Changes.over(DAYS)
    sums = whitened_sums(DAYS, variance, base, changes.columns, scatter)
    mean, flat = np.array([0.0, 0.4]), 1e7
    prior = first_prior(np.array([np.sqrt(flat), 0.5]), scatter, 2)
    prior = replace(prior, mean=np.stack([mean, mean]))
    found = evidence(sums, changes, prior)
    for k, s, a in ((0, 0, 3), (1, 0, 8), (1, 1, 12), (0, 1, 1)):
        there = np.isfinite(variance[s])
        V = _covariance(DAYS[there], variance[s][there], scatter.memory[k], scatter.share[k])
        X, y, h = base[s][there][:, :2], base[s][there][:, 2], changes.columns[there, a]
        none = V + X @ np.diag([flat, 0.25]) @ X.T
        change = none + changes.scale[a] ** 2 * np.outer(h, h)

        # A flat level takes one degree of freedom, which a wide one has back.
        def log(C: np.ndarray, y: np.ndarray = y - X @ mean) -> float:
            r = FREEDOM * SIZE**2 + y @ np.linalg.solve(C, y)
            return -0.5 * (np.linalg.slogdet(C)[1] + (FREEDOM + len(y) - 1) * np.log(r))

        whole = np.log(np.mean(np.exp(found.log_factor[:, k, s, a] - _log_kinds(changes, a))))
        np.testing.assert_allclose(whole, log(change) - log(none), atol=1e-4)
        up, down = np.exp(found.log_factor[:, k, s, a] - _log_kinds(changes, a))
        by_sign = stats.t.cdf(found.size[k, s, a] / found.deviation[k, s, a], found.freedom[s])
        np.testing.assert_allclose(up / (up + down), by_sign, rtol=1e-9)


def test_what_a_drive_is_given_comes_from_the_other_alone() -> None:
    """By conditioning normal distributions: b_i = c + d_i, of which only the other's is seen."""
    variance, base, scatter = _problem(2)
    changes = Changes.over(DAYS)
    sums = whitened_sums(DAYS, variance, base, changes.columns, scatter)
    prior, unlike = first_prior(np.array([2.0, 0.7]), scatter, 2), np.array([np.inf, 0.3])
    alone = evidence(sums, changes, prior)
    found = with_others(alone, changes, prior, unlike, drives=2)
    changed = _A_YEAR * alone.R / (1 + _A_YEAR * alone.R)
    mean, covariance = _moments(alone, changed)
    sigma2 = np.sum(alone.of_kinds * alone.sigma**2, axis=0)
    for drive, other in ((0, 1), (1, 0)):
        common, apart = sigma2[drive] / prior.precision[drive, 1, 1], unlike[1] ** 2
        gain = common / (common + apart + covariance[other, 1, 1])
        np.testing.assert_allclose(found.mean[drive, 1], gain * mean[other, 1], rtol=1e-9)
        left = common + apart - gain * common
        np.testing.assert_allclose(found.precision[drive, 1, 1], sigma2[drive] / left, rtol=1e-9)
        np.testing.assert_array_equal(found.precision[drive, 0], prior.precision[drive, 0])


def _log_kinds(changes: Changes, a: int) -> np.ndarray:
    shares = np.log([share for _, share in KINDS])
    return np.log(changes.share[a]) + (shares[:2] if changes.is_ramp[a] else shares[2:])


def _series(rng: np.random.Generator, robots: int):
    """Friction that follows temperature and wanders."""
    days, n = np.arange(140.0), 140
    T = 6.0 * np.sin(days / 58 + rng.uniform(0, 6, (robots, 1)))
    T += 3 * rng.standard_normal((robots, n))
    y = rng.normal(-0.9, 0.2, (robots, 1, 1)) * T[:, None]
    return days, T + 25, y + 0.8 * rng.standard_normal((robots, 3, n))


def _looked(days, T, y, n: int, known: bool = True, tools: tuple[float, ...] = ()):
    robots = len(y)
    beside = [
        Regressors.for_recordings(
            days[:n], T[k, :n] if known else np.full(n, np.nan), np.zeros(n), tools
        )
        for k in range(robots)
    ]
    flat = y[:, :, :n].reshape(-1, n)
    return explained(days[:n], flat, np.full(flat.shape, 0.2), beside)


def test_steady_fleets_are_left_alone_and_drift_is_found() -> None:
    """Looked at every ten days; two percent a month from the 10th week on."""
    rng = np.random.default_rng(1)
    days, T, y = _series(rng, 24)
    onset = 70
    y[:8, 1] += 2.0 / MONTH * np.maximum(days - onset, 0.0)
    alarm = np.zeros((24, 3), dtype=bool)
    soon = alarm.copy()
    for n in range(30, 141, 10):
        hit = _looked(days, T, y, n).evidence.R.reshape(24, 3) >= 30.0
        alarm |= hit
        soon |= hit & (n - 1 <= onset + 42)
        if n - 1 < onset:
            assert not hit[:8, 1].any()
    assert soon[:8, 1].sum() >= 6
    assert alarm[:8, 1].all()
    alarm[:8, 1] = False
    assert alarm.sum() <= 1


@pytest.mark.parametrize(
    ("change", "state"),
    [
        (lambda t: 3.0 / MONTH * np.maximum(t - 60, 0), "rising"),
        (lambda t: -4.0 / MONTH * np.maximum(t - 60, 0), "falling"),
        (lambda t: 6.0 * (t >= 60), "stepped"),
        (lambda t: 0.0 * t, "steady"),
    ],
)
def test_what_is_said_holds_the_truth(change, state: str) -> None:
    days, T, y = _series(np.random.default_rng(4), 1)
    y[0, 0] += change(days)
    drive_finding = finding(_looked(days, T, y, 140), 0, DriftSettings(limit=1.2), 3)
    assert drive_finding.state == state
    slope = drive_finding.temperature
    assert -0.015 < slope.low < slope.high < -0.003
    if state == "steady":
        assert drive_finding.change.value is None
        assert drive_finding.horizon.value is None
        assert drive_finding.rate.low < 0.0 < drive_finding.rate.high
        return
    assert drive_finding.change.low - 1 <= 60 <= drive_finding.change.high + 1
    if state == "stepped":
        assert drive_finding.step.low < np.expm1(0.06) < drive_finding.step.high
        assert drive_finding.rate.value is None
        return
    rate = np.expm1(0.03 if state == "rising" else -0.04)
    assert drive_finding.rate.low < rate < drive_finding.rate.high
    if state == "rising":
        truth = 60 + MONTH * np.log(1.2) / 0.03
        assert drive_finding.horizon.low < truth < drive_finding.horizon.high
        assert drive_finding.limit == pytest.approx(1.2 * drive_finding.level)


def test_without_temperature_a_season_is_no_drift_and_that_is_said() -> None:
    rng = np.random.default_rng(3)
    days, T, y = _series(rng, 12)
    found = _looked(days, T, y, 140, known=False)
    assert np.sum(found.evidence.R >= 30.0) <= 1
    drive_finding = finding(found, 0, DriftSettings(), 3)
    assert drive_finding.temperature.value is None
    assert "no temperature is known" in drive_finding.reason
    known = finding(_looked(days, T, y, 140), 0, DriftSettings(), 3)
    assert drive_finding.rate.high - drive_finding.rate.low > 2.0 * (
        known.rate.high - known.rate.low
    )


def _few(change: np.ndarray, known: bool, seed: int, apart: float = 7.0):
    """So many recordings, scattering by 0.7 %, with temperature or without."""
    rng, n = np.random.default_rng(seed), len(change)
    days, T = apart * np.arange(n), 25.0 + 2.0 * rng.standard_normal((1, n))
    y = 0.7 * rng.standard_normal((1, 3, n)) - 0.9 * known * (T[:, None] - 25.0)
    y[0, 0] += 100.0 * np.log1p(change)
    return _looked(days, T, y, n, known)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("change", "apart", "state"),
    [
        (0.3 * (np.arange(8) >= 4), 1.0, "stepped"),
        (0.3 * (np.arange(8) >= 4), 7.0, "stepped"),
        (0.6 * np.arange(8) / 7, 8.0, "rising"),
    ],
)
def test_few_recordings_show_a_large_change(change, apart, state: str, known: bool) -> None:
    """A step of 30 % in 4 + 4; 60 % in eight weeks."""
    series = [_few(change, known, seed, apart) for seed in range(3)]
    for estimate in series:
        first, *others = (finding(estimate, drive, DriftSettings(), 3) for drive in range(3))
        assert first.state == state
        assert {other.state for other in others} == {"unknown"}
        assert all(other.reason.startswith("not enough data") for other in others)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("n", [11, 12, 13, 20])
def test_a_large_change_stays_detected_as_recordings_become_many(n: int, known: bool) -> None:
    """Of friction that rises by 60 % in eight weeks from the first recording on."""
    for seed in range(3):
        series = _few(0.6 * np.arange(n) / 16, known, seed, 3.5)
        own, *others = (finding(series, drive, DriftSettings(), 3) for drive in range(3))
        assert own.state == "rising"
        assert own.rate.low is not None
        assert own.rate.low > 0.15
        assert all(other.state != "rising" for other in others)


@pytest.mark.parametrize(("n", "after"), [(2, 1), (4, 2), (5, 2)])
def test_fewer_show_nothing(n: int, after: int) -> None:
    own = finding(_few(0.3 * (np.arange(n) >= n - after), True, 0), 0, DriftSettings(limit=1.5), 3)
    assert own.state == "unknown"
    assert own.rate.value is None
    assert own.horizon.value is None
    assert own.reason.startswith("not enough data")


def test_few_recordings_raise_no_more_alarms_than_promised() -> None:
    """Scattering by 5 % and not by the likely 1 %, looked at with each new one: 0.1 a robot."""
    rng, robots, n = np.random.default_rng(5), 40, 11
    days, T = 3.0 * np.arange(n), 25.0 + rng.standard_normal((robots, n))
    y = 5.0 * rng.standard_normal((robots, 3, n))
    alarm = np.zeros(robots, dtype=bool)
    for k in range(2, n + 1, 3):
        alarm |= np.any(_looked(days, T, y, k).evidence.R.reshape(robots, 3) >= 30.0, axis=1)
    assert alarm.sum() <= 0.1 * robots


def test_gears_that_warm_up_are_no_change() -> None:
    change = 0.3 * (np.arange(8) < 4)
    own = finding(_few(change, False, 0, apart=0.1), 0, DriftSettings(), 3)
    assert own.state == "unknown"


def test_what_stands_apart_counts_less_and_a_ramp_does_not() -> None:
    rng = np.random.default_rng(0)
    y = rng.standard_normal((1, 80)) + 0.1 * np.arange(80)
    y[0, 40], y[0, 50] = y[0, 40] + 15.0, np.nan
    found = inflation(y, np.zeros((1, 80, 0)))[0]
    assert found[40] > 10.0
    assert np.mean(np.delete(found, [40, 50]) > 1.5) < 0.05


def test_a_tool_change_has_its_day_and_mass() -> None:
    rng = np.random.default_rng(2)
    days = np.arange(100.0)
    mass = 0.02 * rng.standard_normal(100) + 0.3 * (days >= 37) - 0.1 * (days >= 70)
    found = tool_changes(days, mass, np.full(100, 0.02), 40.0)
    assert [tool.day for tool in found] == [37.0, 70.0]
    assert found[0].mass == pytest.approx(0.3, abs=0.03)
    assert found[1].mass == pytest.approx(-0.1, abs=0.03)
    assert tool_changes(days, 0.02 * rng.standard_normal(100), np.full(100, 0.02), 40.0) == ()


def test_what_is_known_before_is_that_of_the_grid() -> None:
    prior = first_prior(np.array([np.inf, 2.0]), USUAL_SCATTER, 3)
    np.testing.assert_allclose(np.exp(prior.log_kinds).sum(axis=0), 1.0)
    np.testing.assert_array_equal(prior.precision[0], np.diag([0.0, 0.25]))


def test_a_drive_that_tells_nothing_is_unknown_and_disturbs_no_other() -> None:
    days, T, y = _series(np.random.default_rng(6), 1)
    y[0, 1] = np.nan
    found = _looked(days, T, y, 140)
    unknown, steady = (finding(found, i, DriftSettings(limit=1.5), 3) for i in (1, 0))
    assert unknown.state == "unknown"
    assert unknown.recordings == 0
    assert np.isnan(unknown.level)
    assert unknown.limit is None
    assert "no recording determines" in unknown.reason
    assert steady.state == "steady"


def test_one_recording_is_no_error() -> None:
    days, T, y = _series(np.random.default_rng(6), 1)
    assert finding(_looked(days, T, y, 1), 0, DriftSettings(), 3).state == "unknown"


def test_a_slow_temperature_is_the_mean_of_the_weeks_about_a_day() -> None:
    days, T = np.array([700.0, 703.0, 710.0, 730.0]), np.array([20.0, 30.0, np.nan, 24.0])
    known = np.isfinite(T)
    found = _slow(days, T, known)
    for day, value in zip(days, found, strict=True):
        weights = np.exp(-0.5 * ((day - days[known]) / 7.0) ** 2)
        assert value == pytest.approx(np.average(T[known], weights=weights))
