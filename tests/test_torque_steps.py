"""Where torques step as a drive turns round: at once, behind a filter, or not at all."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from deltaid.effects.reversals import _lag_of
from deltaid.effects.torque_steps import (
    Local,
    Shape,
    Steps,
    _posterior,
    behind_filter,
    blurred,
    butterworth,
    is_abrupt,
    is_rounded,
    locally,
    located,
    misfit,
    ramped,
    rounded,
    sharp,
    twice_rounded,
    yielding,
)

PERIOD, SEEN, SLOPE = 2e-3, 0.8, 20.0
# Time constants that are tried, in samples: eight from 0.1 to 4, and lags so far apart [s].
CONSTANTS, LAGS_APART = np.geomspace(0.1, 4.0, 8), (2 * 1.5e-3 + 4 * PERIOD) / 60


def response(since: np.ndarray, constant: float) -> np.ndarray:
    """A step from −½ to ½ at zero, behind a first-order filter."""
    return np.where(since > 0, 0.5 - np.exp(-np.maximum(since, 0.0) / constant), -0.5)


def steps(
    rng: np.random.Generator, dead: float, constant: float, noise: float, seen: float = SEEN
) -> Steps:
    """Torques of 20 reversals about a step that comes so late, each with an offset and a slope.

    Reversals lie anywhere between two samples; of the model's step a part is seen.
    """
    after = (np.arange(-13, 14) - rng.uniform(0.0, 1.0, (20, 1))) * PERIOD
    jump = rng.choice([-1.0, 1.0], 20) * rng.uniform(1.0, 3.0, 20)
    shape = response(after - dead, constant) if constant else sharp(after, dead)
    left = rng.normal(0.0, 5.0, (20, 1)) + jump[:, None] * (seen * shape + SLOPE * after)
    left += noise * rng.standard_normal(after.shape)
    return Steps(after, left, jump, rng.uniform(1.0, 4.0, 20))


def test_a_step_behind_a_filter_is_its_response() -> None:
    """What is lost before its place is won behind it: delays of filters add up."""
    after, constant = np.linspace(-0.02, 0.06, 40001)[None], 2.5e-3
    found = rounded(after, 4e-3, constant)
    np.testing.assert_allclose(found, response(after - 1.5e-3, constant), atol=1e-12)
    area = 2e-6 * np.sum(sharp(after, 4e-3) - found)
    assert area == pytest.approx(0.0, abs=2e-6)


@pytest.mark.parametrize("constant", CONSTANTS[[2, 4, 6]])
@pytest.mark.parametrize("dead", [-1.3e-3, 0.7e-3])
def test_the_lag_of_a_filter_has_its_time_constant_in_it(constant: float, dead: float) -> None:
    """To half of what lags that are tried lie apart; the deviation that is told holds it."""
    lag = dead + constant * PERIOD
    of_drive = steps(np.random.default_rng(3), dead, constant * PERIOD, noise=0.01)
    found = behind_filter(of_drive, lag + 4e-4, PERIOD)
    assert found[0] == pytest.approx(lag, abs=0.5 * LAGS_APART)
    assert found[1] == pytest.approx(LAGS_APART, rel=0.1)


def test_between_the_constants_that_are_tried_the_lag_is_near() -> None:
    constant = np.sqrt(CONSTANTS[4] * CONSTANTS[5])
    lag = 0.5e-3 + constant * PERIOD
    of_drive = steps(np.random.default_rng(4), 0.5e-3, constant * PERIOD, noise=0.01)
    found = behind_filter(of_drive, lag, PERIOD)
    assert abs(found[0] - lag) < 2 * found[1]


def test_a_filter_in_noise_has_the_least_possible_uncertainty() -> None:
    """By likelihoods of all lags and constants that are tried, whose noise is what the best one
    leaves."""
    lag = 1e-3 + CONSTANTS[4] * PERIOD
    of_drive = steps(np.random.default_rng(5), 1e-3, CONSTANTS[4] * PERIOD, noise=1.2)
    places = lag + np.linspace(-1.5e-3, 1.5e-3 + CONSTANTS[-1] * PERIOD, 61)
    squares = np.array([
        [
            np.sum(locally(of_drive, response(of_drive.after - (x - c), c)).left ** 2)
            for c in CONSTANTS * PERIOD
        ]
        for x in places
    ])  # fmt: skip
    variance = squares.min() / of_drive.left.size
    likely = np.exp((squares.min() - squares) / (2 * variance)).sum(axis=1)
    mean = likely @ places / likely.sum()
    std = np.sqrt(likely @ (places - mean) ** 2 / likely.sum())
    found = behind_filter(of_drive, lag, PERIOD)
    assert found[0] == pytest.approx(mean)
    assert found[1] == pytest.approx(np.hypot(std, LAGS_APART))
    assert std > LAGS_APART
    assert abs(mean - lag) < 2 * std


def test_what_a_filter_leaves_open_is_looked_for_where_the_step_begins() -> None:
    """That is its time constant before the lag."""
    dead, constant = 1e-3, CONSTANTS[-1] * PERIOD
    of_drive = steps(np.random.default_rng(12), dead, constant, noise=0.01)
    before = np.abs(of_drive.after - (dead - 2 * PERIOD)) < 0.5 * PERIOD
    rung = replace(of_drive, left=of_drive.left + 0.9 * of_drive.jump[:, None] * before)
    assert behind_filter(of_drive, dead + constant, PERIOD) is not None
    assert behind_filter(rung, dead + constant, PERIOD) is None


def test_what_is_no_filter_tells_nothing() -> None:
    """Torques without any step, and those that step twice."""
    rng = np.random.default_rng(6)
    none = steps(rng, 1e-3, PERIOD, noise=0.01)
    smooth = replace(none, left=SLOPE * none.jump[:, None] * none.after)
    assert behind_filter(smooth, 1e-3, PERIOD) is None
    ringing = none.left + none.jump[:, None] * np.exp(-((none.after / PERIOD) ** 2))
    assert behind_filter(replace(none, left=ringing), 1e-3, PERIOD) is None


def test_a_sharp_step_lies_where_it_says() -> None:
    """Its place errs by the deviation that is told."""
    rng, z = np.random.default_rng(7), []
    for _ in range(200):
        late = rng.uniform(0.0, PERIOD)
        found = located(steps(rng, late, 0.0, noise=0.25, seen=0.45), late + 0.3e-3, 5e-3)
        z.append((found[0] - late) / found[1])
    assert np.std(z) == pytest.approx(1.0, abs=0.2)  # 200 draws tell it to 0.05
    assert np.mean(z) == pytest.approx(0.0, abs=0.25)
    few = steps(rng, 1e-3, 0.0, noise=0.01)
    three = Steps(*(values[:3] for values in vars(few).values()))
    assert located(three, 1e-3, 5e-3) is None


def test_the_place_of_a_step_has_its_likelihood() -> None:
    """All places within reach are as likely before; summed over a fine grid of them."""
    of_drive, noise = steps(np.random.default_rng(11), 1e-3, 0.0, noise=1.0, seen=1.0), 1.0
    some = Steps(*(values[:4] for values in vars(of_drive).values()))
    left = some.left - SLOPE * some.jump[:, None] * some.after
    left -= left.mean(axis=1, keepdims=True)
    places = np.linspace(-2e-3, 5e-3, 14001)
    shapes = sharp(some.after[None], places[:, None, None])
    # log L = −Σ (r − J s)² / 2σ², of which only the mixed term depends on the place.
    log = np.sum(some.jump[:, None] * left * shapes, axis=(1, 2)) / noise**2
    likely = np.exp(log - log.max())
    mean = likely @ places / likely.sum()
    std = np.sqrt(likely @ (places - mean) ** 2 / likely.sum())
    found = _posterior(some, left, 1.0, noise**2, 1.5e-3, 3.5e-3)
    np.testing.assert_allclose(found, (mean, std), rtol=2e-3)


def test_offsets_a_step_and_a_slope_are_least_squares() -> None:
    of_drive = steps(np.random.default_rng(8), 1e-3, 0.0, noise=0.3)
    shape = sharp(of_drive.after, 1e-3)
    offsets = np.kron(np.eye(20), np.ones((27, 1)))
    both = of_drive.jump[:, None, None] * np.stack([shape, of_drive.after], axis=2)
    A = np.hstack([offsets, both.reshape(-1, 2)])
    weights = np.linalg.lstsq(A, of_drive.left.ravel(), rcond=None)[0]
    found = locally(of_drive, shape)
    np.testing.assert_allclose(found.left.ravel(), of_drive.left.ravel() - A @ weights, atol=1e-9)
    assert found.step_share == pytest.approx(weights[20])


def test_what_samples_next_to_a_step_miss_is_a_share_of_it() -> None:
    """Root mean square of three samples on either side, beyond that of the others."""
    of_drive = steps(np.random.default_rng(9), 0.0, 0.0, noise=0.0)
    near = np.abs(of_drive.after) < 3 * PERIOD
    size = np.sqrt(np.mean(of_drive.jump**2))
    off = Local(size * np.where(near, 0.1, 0.03), 0.5)
    assert misfit(off, of_drive, 0.0) == pytest.approx(np.sqrt(0.1**2 - 0.03**2) / 0.5)
    # A mean square of n numbers scatters by √(2/n); four times that is chance.
    chance = 1 + 4 * np.sqrt(2 / near.sum())
    for share, is_beyond in ((0.999, False), (1.001, True)):
        local = Local(np.where(near, np.sqrt(share * chance), 1.0), 0.5)
        assert (misfit(local, of_drive, 0.0) > 0) == is_beyond


def test_a_step_is_distinguished_from_a_slope_over_many_samples() -> None:
    rng = np.random.default_rng(10)
    abrupt = steps(rng, 0.0, 0.0, noise=0.01)
    ramp = np.clip(abrupt.after / (14 * PERIOD), -0.5, 0.5)
    gradual = replace(abrupt, left=abrupt.jump[:, None] * ramp)
    for recorded, expected in ((abrupt, True), (gradual, False)):
        local = locally(recorded, sharp(recorded.after, 0.0))
        assert is_abrupt(local, recorded, 0.0) == expected


@pytest.mark.parametrize(("share", "expected"), [(0.8, True), (1.25, False)])
def test_a_step_that_noise_hides_nearby_is_a_step(share: float, expected: bool) -> None:
    """Up to three deviations of what seven samples say of it beside a slope."""
    of_drive = steps(np.random.default_rng(13), 0.0, 0.0, noise=4.0, seen=0.2)
    few = replace(of_drive, after=of_drive.after[:, 10:17], left=of_drive.left[:, 10:17])
    near = locally(few, sharp(few.after, 0.0))
    columns = few.jump[:, None] * np.stack([sharp(few.after, 0.0), few.after])
    columns -= columns.mean(axis=2, keepdims=True)
    flat = columns.reshape(2, -1)
    std = float(np.sqrt(np.mean(near.left**2) * np.linalg.inv(flat @ flat.T)[0, 0]))
    local = Local(of_drive.left, near.step_share + share * 3 * std)
    assert is_abrupt(local, of_drive, 0.0) == expected


@pytest.mark.parametrize("noise", [0.6, 0.9])
@pytest.mark.parametrize("seed", range(4))
def test_a_filtered_step_is_searched_later_than_the_sharp_one_that_fits(
    noise: float, seed: int
) -> None:
    """Its lag δ + T is behind the place of a sharp step, never before it."""
    filtered = steps(np.random.default_rng(seed), 1e-3, 1.5 * PERIOD, noise)
    early = locally(filtered, sharp(filtered.after, 1e-3))
    assert is_rounded(early, filtered, 1e-3, PERIOD)
    at_once = steps(np.random.default_rng(seed), 1e-3, 0.0, noise)
    assert not is_rounded(locally(at_once, sharp(at_once.after, 1e-3)), at_once, 1e-3, PERIOD)


def test_sharp_or_filtered_is_decided_by_likelihoods() -> None:
    """The mean likelihood of all constants, each at its best lag, with the noise of the best."""
    decided = list[bool]()
    for seed in range(30):
        filtered = steps(np.random.default_rng(seed), 1e-3, PERIOD, noise=4.0)
        at_once = locally(filtered, sharp(filtered.after, 1e-3))
        squares = [
            min(
                np.sum(locally(filtered, response(filtered.after - 1e-3 - x + T, T)).left ** 2)
                for x in np.linspace(0.0, T, len(CONSTANTS))
            )
            for T in CONSTANTS * PERIOD
        ]
        variance = min(squares) / filtered.left.size
        ratios = np.exp((np.sum(at_once.left**2) - np.array(squares)) / (2 * variance))
        decided.append(is_rounded(at_once, filtered, 1e-3, PERIOD))
        assert decided[-1] == (ratios.mean() > 1.0)
    assert 3 < sum(decided) < 27


# Numerator and denominator of filters whose slow torques are late by 4 ms.
FILTERS = {
    "butterworth": (butterworth, [1.0], [0.5 * 4e-3**2, 4e-3, 1.0]),
    "two filters": (twice_rounded, [1.0], [(0.5 * 4e-3) ** 2, 4e-3, 1.0]),
}


@pytest.mark.parametrize(("shape", "numerator", "denominator"), FILTERS.values(), ids=FILTERS)
def test_blurred_steps_are_responses_of_filters(
    shape: Shape, numerator: list[float], denominator: list[float]
) -> None:
    time = np.linspace(0.0, 0.05, 2001)
    _, expected = signal.step((numerator, denominator), T=time)
    np.testing.assert_allclose(shape(time[None], 4e-3, 4e-3)[0], expected - 0.5, atol=1e-4)
    late = np.sum(1.0 - expected) * (time[1] - time[0])  # that of slow torques
    assert late == pytest.approx(4e-3, abs=2e-5)


def test_steps_in_averages_are_ramps() -> None:
    time = np.arange(-0.02, 0.02, 1e-5)
    averaged = np.convolve(np.sign(time) / 2, np.ones(801) / 801, "same")[1000:-1000]
    found = ramped(time[None], 0.0, 801e-5)[0, 1000:-1000]
    np.testing.assert_allclose(found, averaged, atol=2e-3)


def test_friction_that_yields_follows_the_distance() -> None:
    """½ a u² after the lag, whatever the acceleration a."""
    acceleration, distance = np.array([1.0, 4.0, 9.0]), np.linspace(0.0, 3e-5, 50)
    after = 2e-3 + np.sqrt(2 * distance / acceleration[:, None])
    of_drive = Steps(after, np.zeros_like(after), np.ones(3), acceleration)
    found = yielding(of_drive)(after, 2e-3, 3e-3)
    passed = 4.0 * (3e-3) ** 2
    np.testing.assert_allclose(found, np.tile(0.5 - np.exp(-distance / passed), (3, 1)), atol=1e-12)


def blurry(
    shape: Shape, late: float, time: float, rng: np.random.Generator, noise: float = 0.05
) -> Steps:
    """Steps of a shape in samples of 1 ms, wide about the reversals."""
    after = (np.arange(-24, 25) - rng.uniform(0.0, 1.0, (20, 1))) * 1e-3
    jump, acceleration = rng.choice([-1.0, 1.0], 20), rng.uniform(1.0, 4.0, 20)
    of_drive = Steps(after, np.zeros_like(after), jump, acceleration)
    form = yielding(of_drive) if shape is yielding else shape
    clean = rng.normal(0.0, 5.0, (20, 1)) + jump[:, None] * (
        form(after, late, time) + SLOPE * after
    )
    return replace(of_drive, left=clean + noise * rng.standard_normal(after.shape))


@pytest.mark.parametrize(
    ("shape", "time", "reach"), [(ramped, 8e-3, 4e-3), (butterworth, 4.5e-3, 9e-3),
                                 (twice_rounded, 6e-3, 12e-3)]
)  # fmt: skip
def test_blurred_steps_have_a_lag_and_a_reach(shape: Shape, time: float, reach: float) -> None:
    """The times that are tried are 22 % apart."""
    for seed in range(5):
        of_drive = blurry(shape, 3.5e-3, time, np.random.default_rng(seed))
        lag, deviation, around = blurred(of_drive, 3e-3, 1e-3)
        assert lag == pytest.approx(3.5e-3, abs=4e-4)
        assert deviation < 3e-4
        assert reach / 1.3 < around < reach * 1.3


@pytest.mark.parametrize("shape", [sharp, rounded, yielding])
def test_other_steps_are_not_blurred(shape: Shape) -> None:
    def form(after: np.ndarray, late: float, time: float) -> np.ndarray:
        return sharp(after, late)

    for seed in range(5):
        used = form if shape is sharp else shape
        of_drive = blurry(used, 2.5e-3, 3e-3, np.random.default_rng(seed))
        assert blurred(of_drive, 2.5e-3, 1e-3) is None
    none = replace(of_drive, left=np.random.default_rng(0).standard_normal(of_drive.left.shape))
    assert blurred(none, 2.5e-3, 1e-3) is None
    assert blurred(replace(none, jump=np.zeros(20)), 2.5e-3, 1e-3) is None  # without friction
    assert blurred(Steps(*(values[:3] for values in vars(of_drive).values())), 0.0, 1e-3) is None


def test_noise_alone_makes_no_filter_a_blur() -> None:
    """Where steps are as small as the noise, shapes differ by chance."""
    rng = np.random.default_rng(14)
    drives = [blurry(rounded, 2.5e-3, 2e-3, rng, noise=1.0) for _ in range(40)]
    assert not any(blurred(of_drive, 2.5e-3, 1e-3) for of_drive in drives)


@pytest.mark.parametrize("bump", [0.0, 0.05])
def test_the_deviation_of_a_sharp_step_counts_instants_and_misfit(bump: float) -> None:
    """A tenth of a sample in each step, and what samples next to steps miss, as a share of one."""
    of_drive = steps(np.random.default_rng(15), 1e-3, 0.0, noise=0.002)
    sign = np.resize([1.0, -1.0], of_drive.after.shape[1])
    near = np.abs(of_drive.after - 1e-3) < 3 * PERIOD
    of_drive = replace(of_drive, left=of_drive.left + bump * sign * near * of_drive.jump[:, None])
    lag = _lag_of(lambda known, reach: of_drive, 1e-3, 1 / PERIOD)
    place, deviation = located(of_drive, lag.value, 1.5e-3 + PERIOD)
    off = misfit(locally(of_drive, sharp(of_drive.after, place)), of_drive, place)
    assert (off > 0.02) == (bump > 0)
    apart = max(0.1 * PERIOD / np.sqrt(20), off * PERIOD)
    assert lag == (pytest.approx(place), pytest.approx(np.hypot(deviation, apart)), False, False, 0)
