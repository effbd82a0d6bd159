"""The alarm on drift: what it goes by, against dense formulas, and how seldom it is false."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from deltaid.fleets.drift_evidence import (
    _A_YEAR,
    _TOGETHER,
    FREEDOM,
    RAMP,
    SIZE,
    STEEP,
    STEP,
    YEAR,
    ChangeEvidence,
    Changes,
    evidence,
    first_prior,
    with_others,
)
from deltaid.fleets.drift_findings import DriftSettings, finding
from deltaid.fleets.drift_scatter import DailyScatter, whitened_sums
from deltaid.fleets.drift_series import Explained, Regressors, explained
from deltaid.fleets.robot_drift import tool_changes

# How usual changes are, as they are promised: a ramp up or down, a step up or down.
RAMPS, STEPS = (0.6, 0.1), (0.2, 0.1)
SCATTER = DailyScatter(np.array([1.0, 7.0]), np.array([0.0, 0.6]), np.array([0.7, 0.3]))
WEEK = 7.0


def _evidence(
    days: np.ndarray, y: np.ndarray, variance: np.ndarray, changes: Changes
) -> ChangeEvidence:
    """Evidence of series with a level that may be anywhere."""
    base = np.stack([np.ones_like(y), y], axis=2)
    sums = whitened_sums(days, variance, base, changes.columns, SCATTER)
    return evidence(sums, changes, first_prior(np.array([1e4]), SCATTER, len(y)))


@pytest.mark.parametrize("span", [70.0, 3650.0])
def test_where_nothing_is_reported_the_alarm_goes_by_the_years_that_passed(span: float) -> None:
    """What R exceeds them by is told by recordings; onsets lie a week apart, or there are 60."""
    days, nothing = np.linspace(0.0, span, 40), np.full((1, 40), np.inf)
    found = _evidence(days, np.zeros((1, 40)), nothing, Changes.over(days))
    assert span - max(WEEK, span / 60) <= YEAR * found.R[0] <= span
    steps = _evidence(days, np.zeros((1, 40)), nothing, Changes.steps(days))
    assert YEAR * steps.R[0] == pytest.approx(sum(STEPS) * span)


def test_the_alarm_goes_by_marginal_likelihoods_of_all_changes() -> None:
    """R of a drive is Σ_k (years between onsets) π B_k, from one dense normal matrix a change."""
    rng = np.random.default_rng(4)
    days, flat = np.sort(rng.uniform(0.0, 50.0, 25)), 1e4
    variance, y = rng.uniform(0.5, 3.0, 25), 1.5 * rng.standard_normal(25)
    changes = Changes.over(days)
    n = len(np.unique(changes.onsets))
    found = _evidence(days, y[None], variance[None], changes)

    nu = FREEDOM + len(y) - 1  # a level that may be anywhere takes one
    apart, ones = np.abs(days[:, None] - days), np.ones(25)
    total, none = 0.0, 0.0
    for k, (T, share, usual) in enumerate(
        zip(SCATTER.memory, SCATTER.share, SCATTER.usual, strict=True)
    ):
        V = share * np.exp(-apart / T) + (1 - share) * np.diag(variance)
        C = V + flat**2 * np.outer(ones, ones)

        def likelihood(C: np.ndarray) -> tuple[float, float]:
            r = FREEDOM * SIZE**2 + y @ np.linalg.solve(C, y)
            return np.linalg.det(C) ** -0.5 * r ** (-nu / 2), r

        plain, r = likelihood(C)
        none += usual * plain
        np.testing.assert_allclose(found.sigma[k, 0], np.sqrt(r / nu), rtol=1e-5)
        level = 1 / (ones @ np.linalg.solve(V, ones))
        np.testing.assert_allclose(found.covariance[k, 0], level * r / nu, rtol=1e-5)
        for a, onset in enumerate(changes.onsets):
            ramp = changes.is_ramp[a]
            h = np.maximum(days - onset, 0.0) * 12 / YEAR if ramp else 1.0 * (days >= onset)
            scale = (RAMP if a < n else STEEP) if ramp else STEP
            changed, left = likelihood(C + scale**2 * np.outer(h, h))
            sharp = scale**-2 + h @ np.linalg.solve(C, h)
            size, std = h @ np.linalg.solve(C, y) / sharp, np.sqrt(left / nu / sharp)
            np.testing.assert_allclose(found.size[k, 0, a], size, atol=1e-5)
            np.testing.assert_allclose(found.deviation[k, 0, a], std, rtol=1e-5)
            up, down = RAMPS if ramp else STEPS
            above = stats.t.cdf(size / std, nu)
            of_kind = (0.9 if a < n else 0.1) if ramp else 1.0  # a tenth of ramps is steep
            total += usual * changed * 2 * of_kind * (up * above + down * (1 - above))
    np.testing.assert_allclose(found.R[0], WEEK / YEAR * total / none, rtol=1e-5)


def _weekly(robots: int, weeks: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Steady drives, three a robot, whose friction scatters by a percent."""
    y = np.random.default_rng(seed).standard_normal((3 * robots, weeks))
    return WEEK * np.arange(weeks), y


def _looked(days: np.ndarray, y: np.ndarray) -> Explained:
    beside = Regressors.for_recordings(days, 25.0 + np.sin(days), np.zeros(len(days)))
    return explained(days, y, np.full(y.shape, 0.2), [beside] * (len(y) // 3))


def test_steady_drives_raise_no_more_alarms_than_is_promised() -> None:
    """Over two years, looked at each year, at one false alarm in two robot-years."""
    robots, settings = 15, DriftSettings(false_alarms=0.5)
    days, y = _weekly(robots, 104, 0)
    alarm = np.zeros(len(y), dtype=bool)
    for n in (52, 104):
        found = _looked(days[:n], y[:, :n])
        alarm |= finding(found, 0, settings, 3).threshold <= found.evidence.R
    assert alarm.sum() <= settings.false_alarms * robots * days[-1] / YEAR


def test_an_alarm_begins_where_all_drives_share_the_false_alarms() -> None:
    """Of three drives at 0.1 a robot-year each may run for 30 years."""
    days, y = _weekly(1, 60, 3)
    y[0] += 0.3 * np.maximum(np.arange(60) - 30, 0)
    found = _looked(days, y)
    assert found.evidence.R[0] > 30.0
    for R, state in ((30.1, "rising"), (29.9, "steady")):
        near = replace(found, evidence=replace(found.evidence, R=np.full(3, R)))
        assert finding(near, 0, DriftSettings(false_alarms=0.1), 3).state == state


def test_scatter_is_what_the_deviations_of_recordings_leave() -> None:
    """Recordings that err by 3 % scatter by √(1² + 3²) % where friction itself does by 1 %."""
    days, y = _weekly(10, 60, 5)
    std = np.full(y.shape, 3.0)
    regressors = Regressors.for_recordings(days, 25.0 + np.sin(days), np.zeros(len(days)))
    found = explained(days, np.sqrt(10.0) * y, std, [regressors] * 10).evidence
    sigma = np.sum(found.of_kinds * found.sigma, axis=0)
    assert np.sqrt(np.mean(sigma**2)) == pytest.approx(1.0, abs=0.1)


def test_a_tool_change_errs_as_it_says() -> None:
    rng, days = np.random.default_rng(1), np.arange(40.0)
    z = []
    for _ in range(60):
        mass = rng.standard_normal(40) + 9.0 * (days >= 15)
        (tool_change,) = tool_changes(days, mass, np.full(40, 0.1), 40.0)
        z.append((tool_change.mass - 9.0) / tool_change.std)
    assert np.std(z) == pytest.approx(1.0, abs=0.18)  # 60 draws tell it to 9 %


def test_what_a_drive_shows_of_scatter_reckons_with_a_change() -> None:
    """Which kind of scatter the other drive has, were it to change as often as drives do."""
    rng = np.random.default_rng(0)
    days = np.sort(rng.uniform(0.0, 60.0, 30))
    y = rng.standard_normal((2, 30)) + np.array([[0.0], [1.0]]) * (days > 25)
    changes = Changes.over(days)
    base = np.stack([np.ones_like(y), y], axis=2)
    sums = whitened_sums(days, np.ones((2, 30)), base, changes.columns, SCATTER)
    prior = first_prior(np.array([1e4]), SCATTER, 2)
    alone = evidence(sums, changes, prior)
    found = with_others(alone, changes, prior, np.array([np.inf]), drives=2)
    factor = np.exp(alone.log_factor).sum(axis=(0, 3)) * WEEK / YEAR
    likely = np.exp(alone.log_none - alone.log_none.max()) * (1 + _A_YEAR * factor)
    likely /= SCATTER.usual[:, None]
    for drive, other in ((0, 1), (1, 0)):
        expected = SCATTER.usual * likely[:, other] ** _TOGETHER
        np.testing.assert_allclose(np.exp(found.log_kinds[:, drive]), expected / expected.sum())
