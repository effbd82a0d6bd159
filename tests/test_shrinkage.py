"""Least squares over groups that are shrunk by evidence, and which of them are kept."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.estimation.causes import CauseColumns, NoiseBlock
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.shrinkage import Shrunk
from deltaid.identification import selection
from deltaid.identification.contest import Contest
from deltaid.identification.selection import _eliminated, reduced, rivals, suspects

LEAST = 6.0


def problem(seed: int = 0, size: float = 1.0, mean: float = 0.0) -> Shrunk:
    """Blocks of unlike noise: columns 0 and 1 free, 2 to 4 a cause of some size, 5 and 6 none."""
    rng = np.random.default_rng(seed)
    x = np.array([1.0, -2.0, *(size * np.array([1.0, -0.5, 0.8])), 0.0, 0.0])
    blocks = []
    for noise in (0.1, 0.4):
        A = rng.standard_normal((400, 7))
        b = A @ x + noise * rng.standard_normal(400)
        blocks.append(NoiseBlock(A, b, np.repeat(np.arange(40), 10), 5.0))
    D = np.eye(7)[:2] / 10.0
    groups = [
        CauseColumns("cause", np.array([2, 3, 4]), np.full(3, 0.5), np.full(3, mean)),
        CauseColumns("nothing", np.array([5, 6]), np.full(2, 0.5), np.zeros(2)),
    ]
    return Shrunk.fitted(blocks, D, np.zeros(2), groups)


def prior(fit: Shrunk) -> tuple[np.ndarray, np.ndarray]:
    return fit.rows.D, fit.rows.d


def test_a_cause_is_found_with_its_noise_and_nothing_else_is_kept() -> None:
    full = problem()
    assert full.x[2:5] == pytest.approx([1.0, -0.5, 0.8], abs=0.03)
    assert full.sigma == pytest.approx([0.1, 0.4], rel=0.4)
    assert full.surprise(full.groups[0]) > 100 > 2 > full.surprise(full.groups[1])
    assert reduced(full, LEAST).candidates == ("cause",)


def test_a_coefficient_without_a_column_is_no_freedom() -> None:
    full = problem(size=0.05)
    blocks = [replace(block, A=np.pad(block.A, ((0, 0), (0, 1)))) for block in full.blocks]
    cause = replace(
        full.groups[0], columns=np.array([2, 3, 4, 7]), deviation=np.full(4, 0.5), mean=np.zeros(4)
    )
    D, d = prior(full)
    wide = Shrunk.fitted(blocks, np.pad(D, ((0, 0), (0, 1))), d, [cause, full.groups[1]])
    assert wide.surprise(cause) == pytest.approx(full.surprise(full.groups[0]), rel=1e-6)


def test_by_how_much_chance_changes_the_level_of_noise() -> None:
    """Of a quarter of 800 rows that are independent, against 2,000 levels of 200 numbers."""
    blocks = tuple(replace(block, independent=0.25) for block in problem().blocks)
    levels = np.std(np.random.default_rng(0).standard_normal((2000, 200)), axis=1)
    spread = replace(problem(), rows=replace(problem().rows, blocks=blocks)).noise_spread
    assert spread == pytest.approx(float(np.std(np.log(levels))), rel=0.05)


def test_excluded_rows_change_nothing() -> None:
    """They are zero, and no evidence of less noise."""
    full = problem(size=0.05)
    longer = tuple(
        replace(
            block,
            A=np.pad(block.A, ((0, more), (0, 0))),
            b=np.pad(block.b, (0, more)),
            stretches=np.pad(block.stretches, (0, more), mode="edge"),
            counted=400 / (400 + more),
        )
        for block, more in zip(full.blocks, (200, 80), strict=True)
    )
    part = Shrunk.fitted(longer, *prior(full), full.groups)
    assert np.allclose(part.x, full.x, rtol=1e-12)
    assert np.allclose(part.sigma, full.sigma, rtol=1e-12)
    cause = full.groups[0]
    for of in (Shrunk.size, Shrunk.surprise, Shrunk.level):
        assert of(part, cause) == pytest.approx(of(full, cause), rel=1e-9)
    assert part.noise_spread == pytest.approx(full.noise_spread, rel=1e-12)
    assert part._unfitted == pytest.approx(full._unfitted, rel=1e-9)
    columns = np.random.default_rng(1).standard_normal((400, 3, 2))
    padded = np.pad(columns, ((0, 80), (0, 0), (0, 0)))
    explained, of_all = (
        fit.explained([1], [columns], 1e-3)[0] for fit, columns in ((part, padded), (full, columns))
    )
    assert explained == pytest.approx(of_all, rel=1e-9)
    contests = [Mock(spec=Contest, shrunk=fit) for fit in (part, full)]
    noise = [Contest.noise.fget(each) for each in contests]
    assert noise[0] == pytest.approx(noise[1], rel=1e-12)


def test_what_is_not_needed_shrinks_and_what_is_large_widens() -> None:
    small, large = problem(size=0.0), problem(size=10.0)
    assert small.alpha[0] < 0.2 < 2.9 < large.alpha[0]
    assert reduced(small, LEAST).candidates == ()


def test_the_minimiser_is_that_of_ridge_regression() -> None:
    full = problem()
    weights = np.concatenate([np.full(400, 1 / sigma) for sigma in full.sigma])
    rows = np.vstack([block.A for block in full.blocks]) * weights[:, None]
    right = np.concatenate([block.b for block in full.blocks]) * weights
    prior = np.concatenate([[10.0, 10.0], 0.5 * np.repeat(full.alpha, [3, 2])])
    A = np.vstack([rows, np.diag(1 / prior)])
    x = np.linalg.lstsq(A, np.append(right, np.zeros(7)))[0]
    assert full.x == pytest.approx(x, abs=1e-9)
    assert full.covariance == pytest.approx(np.linalg.inv(A.T @ A), abs=1e-9)


def test_a_price_is_what_the_minimum_grows_by_without_the_group() -> None:
    full = problem(size=0.02)

    def cost(x: np.ndarray) -> float:
        rows = sum(
            float(np.sum((block.b - block.A @ x) ** 2)) / sigma**2
            for block, sigma in zip(full.blocks, full.sigma, strict=True)
        )
        u = [
            (x[g.columns] - g.mean) / (a * g.deviation)
            for g, a in zip(full.groups, full.alpha, strict=True)
        ]
        D, d = prior(full)
        return rows + float(np.sum((D @ x - d) ** 2)) + sum(float(v @ v) for v in u)

    group = full.groups[0]
    x = full.without({"cause"}).x
    own = full.covariance[np.ix_(group.columns, group.columns)]
    price = float(full.x[group.columns] @ np.linalg.solve(own, full.x[group.columns]))
    assert cost(x) - cost(full.x) == pytest.approx(price, rel=1e-6)


def test_more_columns_explain_what_the_minimum_falls_by() -> None:
    full, rng, alike = problem(size=0.1), np.random.default_rng(4), 0.01
    bare = full.without({"cause"})
    sets = [
        np.stack([b.A[:, 2:5] + b.A[:, :1], rng.standard_normal((400, 3))], axis=1)
        for b in full.blocks
    ]
    explained, coefficients = bare.explained((0, 1), sets, alike)
    weights = np.repeat(1 / bare.sigma, 400)
    b = np.concatenate([block.b for block in bare.blocks]) * weights
    rows = np.vstack([block.A[:, [0, 1, 5, 6]] for block in bare.blocks]) * weights[:, None]
    deviations = np.concatenate([[10.0, 10.0], 0.5 * np.repeat(bare.alpha, 2)])
    before, x = np.vstack([rows, np.diag(1 / deviations)]), bare.x[[0, 1, 5, 6]]
    e = (b - rows @ x).reshape(2, -1)
    cost = float(np.sum(e**2) + np.sum((x / deviations) ** 2))
    for k, value in enumerate(explained):
        more = np.concatenate([columns[:, k] for columns in sets]) * weights[:, None]
        own = np.sqrt(alike * np.sum(more**2, axis=0))
        A = np.block(
            [[before, np.vstack([more, np.zeros((4, 3))])], [np.zeros((3, 4)), np.diag(own)]]
        )
        right = np.append(b, np.zeros(7))
        solution = np.linalg.lstsq(A, right)[0]
        least = float(np.sum((right - A @ solution) ** 2))
        assert value == pytest.approx((cost - least) / np.mean(e**2), rel=1e-6)
        assert coefficients[k] == pytest.approx(solution[4:], rel=1e-6)
    assert explained[0] > 50 > 20 > explained[1]


def test_without_a_group_its_coefficients_are_the_mean_of_their_prior() -> None:
    """And the others are those of a fit that has never had its columns."""
    full = problem(mean=0.3)
    dropped = full.without({"cause"})
    assert dropped.x[2:5].tolist() == [0.3, 0.3, 0.3]
    assert not dropped.covariance[2:5].any()
    others = [0, 1, 5, 6]
    blocks = [
        replace(block, A=block.A[:, others], b=block.b - block.A[:, 2:5] @ np.full(3, 0.3))
        for block in full.blocks
    ]
    D, d = prior(full)
    groups = [replace(full.groups[1], columns=np.array([2, 3]))]
    fitted = Shrunk.fitted(blocks, D[:, others], d, groups)
    never = replace(fitted, alpha=dropped.alpha, rows=replace(fitted.rows, sigma=dropped.sigma))
    assert dropped.x[others] == pytest.approx(never.x)
    assert dropped.covariance[np.ix_(others, others)] == pytest.approx(never.covariance)
    assert dropped.evidence == pytest.approx(never.evidence)
    assert full.of_candidates(["nothing"]).level(full.groups[1]) == pytest.approx(
        never._settled(noise=False).level(groups[0])
    )
    for mine, theirs in zip(
        dropped.rows_of(full.groups[1], 1), never.rows_of(groups[0], 1), strict=True
    ):
        assert mine == pytest.approx(theirs)


@pytest.mark.parametrize(("wrong", "more"), [("wrong", 0.0), ("unexplained its torque", 0.5)])
def test_of_two_that_look_alike_the_right_one_is_kept(wrong: str, more: float) -> None:
    """Also where the wrong one is a free function, and another leaves more than is its own."""
    rng, time = np.random.default_rng(3), "unexplained time"
    right, slow = rng.standard_normal((2, 800))
    alike = np.stack([right + 0.2 * rng.standard_normal(800) for _ in range(3)], axis=1)
    noisy = right + more * slow + 0.05 * rng.standard_normal(800)
    A = np.column_stack([right, alike, slow])
    block = NoiseBlock(A, noisy, np.repeat(np.arange(40), 20), 3.0)
    groups = [
        CauseColumns("right", np.array([0]), np.array([0.1]), np.zeros(1)),
        CauseColumns(wrong, np.array([1, 2, 3]), np.full(3, 1.0), np.zeros(3)),
        CauseColumns(time, np.array([4]), np.ones(1), np.zeros(1)),
    ]
    full = Shrunk.fitted([block], np.zeros((0, 5)), np.zeros(0), groups)
    assert reduced(full, LEAST).candidates == (("right", time) if more else ("right",))


@pytest.mark.parametrize(("size", "kept"), [(0.3, ()), (0.7, ("small",))])
def test_what_is_smaller_than_all_that_no_effect_explains_is_dropped(
    size: float, kept: tuple[str, ...]
) -> None:
    rng, time = np.random.default_rng(3), "unexplained time"
    A = rng.standard_normal((800, 2))
    b = A @ [size, 0.5] + 0.05 * rng.standard_normal(800)
    block = NoiseBlock(A, b, np.repeat(np.arange(40), 20), 3.0)
    groups = [
        CauseColumns(name, np.array([k]), np.ones(1), np.zeros(1))
        for k, name in enumerate(("small", time))
    ]
    full = Shrunk.fitted([block], np.zeros((0, 2)), np.zeros(0), groups)
    assert reduced(full, LEAST).candidates == (*kept, time)


@pytest.mark.parametrize(("size", "kept_first"), [(0.007, ""), (0.05, "abcd")])
def test_a_cause_dropped_beside_others_is_added_again_without_them(
    size: float, kept_first: str
) -> None:
    """The cause is the sum of four: beside these it is needless, and each of these is small, or
    needless only beside the cause."""
    rng = np.random.default_rng(3)
    parts = rng.standard_normal((800, 4))
    A = np.column_stack([parts, parts.sum(axis=1)])
    b = size * A[:, 4] + 0.05 * rng.standard_normal(800)
    block = NoiseBlock(A, b, np.repeat(np.arange(40), 20), 3.0)
    groups = [
        CauseColumns(name, np.array([k]), np.full(1, deviation), np.zeros(1))
        for k, (name, deviation) in enumerate((*((c, 1.0) for c in "abcd"), ("whole", 0.1)))
    ]
    full = Shrunk.fitted([block], np.zeros((0, 5)), np.zeros(0), groups)
    assert _eliminated(full, LEAST, by_size=True).candidates == tuple(kept_first)
    assert reduced(full, LEAST).candidates == ("whole",)


def test_a_cause_that_makes_rows_less_probable_is_not_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bare, larger = (
        Mock(spec=Shrunk, candidates=names, groups=(), droppable=(), evidence=evidence)
        for names, evidence in (((), 0.0), (("cause",), -1.0))
    )
    bare.of_candidates.side_effect = {(): bare, ("cause",): larger}.__getitem__
    monkeypatch.setattr(selection, "suspects", lambda full, now: {"cause": larger})
    monkeypatch.setattr(selection, "rivals", lambda *given: {})
    assert reduced(bare, LEAST) is bare


def test_slow_errors_count_as_noise() -> None:
    rng = np.random.default_rng(4)
    slow = np.repeat(rng.standard_normal(40), 20)
    block = NoiseBlock(rng.standard_normal((800, 1)), slow, np.repeat(np.arange(40), 20), 3.0)
    group = CauseColumns("nothing", np.array([0]), np.ones(1), np.zeros(1))
    full = Shrunk.fitted([block], np.zeros((0, 1)), np.zeros(0), [group])
    assert full.sigma[0] > 2.0 * np.std(slow)


def test_what_rows_say_is_in_units_of_the_noise_behind_a_low_pass() -> None:
    """Rows of a low-pass share noise, and a fit of many columns takes some of it."""
    rng, n = np.random.default_rng(0), 8
    taps = np.sinc(np.arange(-40, 41) / 12) * np.hamming(81)
    taps /= taps.sum()
    x, squares = np.array([3.0, -1.0, 2.0]), list[float]()
    for _ in range(60):
        blocks = []
        for _ in range(2):
            samples = rng.standard_normal((1700, 30))
            rows = np.array([np.convolve(column, taps, "valid")[::n] for column in samples.T]).T
            A, noise = rows[:, :-1], rows[:, -1]
            stretches = np.arange(len(A)) * 40 // len(A)
            independent = n * float(taps @ taps)
            blocks.append(NoiseBlock(A, A[:, :3] @ x + noise, stretches, 5.0, independent))
        groups = [CauseColumns("cause", np.arange(3), np.full(3, 5.0), np.zeros(3))]
        fit = Shrunk.fitted(blocks, np.zeros((0, 29)), np.zeros(0), groups)
        A, b = fit.rows_of(groups[0], 3)
        squares.append(float(np.mean((b - A @ x) ** 2)))
    # of 180 squares the mean scatters by 0.1; taken for white noise they come to 1.4
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)


def test_what_is_within_the_error_of_positions_is_not_kept() -> None:
    full = problem(size=0.02)
    blocks = [replace(block, largest=1e4) for block in full.blocks]
    assert reduced(Shrunk.fitted(blocks, *prior(full), full.groups), LEAST).candidates == ()


def test_what_physics_does_not_allow_stands_for_something_else() -> None:
    full = problem(mean=0.5)
    applied: list[np.ndarray] = []

    def grows(values: np.ndarray, _covariance: np.ndarray) -> bool:
        applied.append(values)
        return bool(values.sum() > 0.0)

    impossible = replace(full.groups[0], is_possible=grows)
    barred = Shrunk.fitted(full.blocks, *prior(full), [impossible, full.groups[1]])
    assert reduced(full, LEAST).candidates == ("cause",)
    assert reduced(barred, LEAST).candidates == ()
    assert applied[0] == pytest.approx(full.x[2:5] - 0.5)  # of all that is applied
    allowed = replace(impossible, is_possible=lambda *values: not grows(*values))
    kept = Shrunk.fitted(full.blocks, *prior(full), [allowed, full.groups[1]])
    assert reduced(kept, LEAST).candidates == ("cause",)


def test_slopes_know_a_step_to_no_better_than_its_size() -> None:
    """What is applied by one step of slopes may be off by the step."""
    (group,) = problem(mean=-0.5).groups[:1]
    given: list[np.ndarray] = []

    def allowed(_values: np.ndarray, covariance: np.ndarray) -> bool:
        given.append(covariance)
        return True

    x, covariance = np.zeros(5), 1e-6 * np.eye(5)
    x[group.columns] = [0.3, -0.2, 0.1]
    replace(group, is_possible=allowed).allows(x, covariance)
    step = x[group.columns]
    np.testing.assert_allclose(given[0], np.outer(step, step) + 1e-6 * np.eye(3))


def test_what_physics_does_not_allow_is_no_rival() -> None:
    full = problem()
    like = [block.A[:, 2:5] for block in full.blocks]
    both = full.with_groups([("double", like, np.full(3, 0.5))])
    kept = reduced(both, LEAST)
    (dropped,) = {"cause", "double"} - set(kept.candidates)
    never = {dropped: lambda *_: False}
    groups = [replace(g, is_possible=never.get(g.name, g.is_possible)) for g in both.groups]
    barred = Shrunk.fitted(both.blocks, *prior(both), groups)
    assert rivals(both, kept, LEAST)
    assert not rivals(barred, kept, LEAST)


def test_a_cause_that_chance_gives_too_often_is_a_suspect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are certainly more probable with it, and chance explains as much once in 10⁵ times."""

    def certain(full: Shrunk) -> set[str]:
        contest = Contest(Mock(spec=TraceRows), (), (), full)
        bare = contest.reduced()
        assert bare.shrunk.candidates == ()
        tried = contest.suspects(bare).items()
        return {name for name, suspect in tried if suspect.is_certain(name, bare)}

    full = problem(size=0.015)
    assert LEAST > full.surprise(full.groups[0]) > 5
    assert certain(full) == {"cause"}
    assert certain(problem(size=0.01)) == set()
    bare = reduced(full, LEAST)
    assert suspects(full, full.of_candidates(["cause"])).keys() == {"nothing"}
    odds = {name: trial.evidence - bare.evidence for name, trial in suspects(full, bare).items()}
    assert odds["cause"] > np.log(100.0) > 1.0 > odds["nothing"]
    never = [replace(group, is_possible=lambda *_: False) for group in full.groups]
    assert suspects(Shrunk.fitted(full.blocks, *prior(full), never), bare) == {}
    # What errors of positions may make is none, nor what chance makes by the scatter of rows.
    far = [replace(block, largest=500.0) for block in full.blocks]
    assert certain(Shrunk.fitted(far, *prior(full), full.groups)) == set()
    for decades, names in ((1.9, set()), (2.1, {"cause"})):
        monkeypatch.setattr(Shrunk, "surprise", lambda *_, seldom=decades: seldom)
        assert certain(full) == names


def test_what_cannot_be_negative_stays_at_zero() -> None:
    free = problem()
    groups = [replace(free.groups[0], is_positive=True), free.groups[1]]
    bounded = Shrunk.fitted(free.blocks, *prior(free), groups)
    assert free.x[3] == pytest.approx(-0.5, abs=0.03)
    assert bounded.x[3] == pytest.approx(0.0, abs=1e-5)
    assert bounded.x[[2, 4]] == pytest.approx(free.x[[2, 4]], abs=0.1)


def test_the_rest_follows_a_group_as_if_fitted_to_it() -> None:
    full = problem()
    group, others = full.groups[0], [0, 1, 5, 6]
    follows = full.follows([group])
    K, own = np.linalg.inv(full.covariance), group.columns
    refitted = -np.linalg.solve(K[np.ix_(others, others)], K[np.ix_(others, own)] @ follows[own])
    assert follows[others] == pytest.approx(refitted, rel=1e-6, abs=1e-12)
    assert np.linalg.norm(follows[own], axis=1) == pytest.approx(full.deviation(group), rel=1e-6)
    assert full.follows([]).shape == (7, 0)


@pytest.mark.parametrize("apart", [1e-3, 1.0])
def test_a_cause_that_looks_like_another_is_its_rival(apart: float) -> None:
    full = problem()
    rng = np.random.default_rng(3)
    like = [block.A[:, 2:5] + apart * rng.standard_normal((400, 3)) for block in full.blocks]
    both = full.with_groups([("double", like, np.full(3, 0.5))])
    kept = reduced(both, LEAST)
    pairs = {frozenset(pair) for pair in rivals(both, kept, LEAST)}
    assert pairs == ({frozenset({"cause", "double"})} if apart < 0.1 else set())
