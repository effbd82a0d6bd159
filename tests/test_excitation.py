"""Excitation: exact gradients, rest at both ends, limits on finer grids, predictions."""

import sys
from dataclasses import replace
from threading import Event
from typing import get_args

import numpy as np
import pytest

from command import refused, run
from deltaid.control.options import ControllerName
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.exports.options import TargetName
from deltaid.model.options import Method
from deltaid.motion.excitation.excite import Excitation, ExcitationSettings, Exciter
from deltaid.motion.excitation.optimize import largest_use, optimise, random_start
from deltaid.motion.excitation.problem import criterion
from deltaid.motion.excitation.run import plan_run, sample_run
from deltaid.motion.excitation.settings import CriterionName
from deltaid.robot.load import load_robot
from sweeps import swept

CRITERIA = ("cond", "logdet", "a-optimal", "e-optimal")


@pytest.fixture(scope="module")
def exciters() -> dict[str, Exciter]:
    return {
        name: Exciter(compiled(load_robot(name)), ExcitationSettings(starts=starts))
        for name, starts in (("irb360-6-1600", 1), ("clavel-delta3", 2))
    }


@pytest.fixture(scope="module")
def optima(exciters) -> dict[str, Excitation]:
    """What either exciter finds, for all that only look at it."""
    return {name: exciter.optimise() for name, exciter in exciters.items()}


@pytest.mark.parametrize("name", CRITERIA)
def test_criterion_is_what_its_name_says(name) -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((30, 6))
    G = A.T @ A
    inverse, n = np.linalg.inv(G), 6
    expected = {
        "cond": np.log(np.linalg.cond(G)),
        "logdet": -np.linalg.slogdet(G)[1] / n,
        "a-optimal": np.log(np.trace(inverse) / n),
        "e-optimal": np.log(np.linalg.norm(inverse, 2)),
    }
    value, slope = criterion(name, G)
    assert value == pytest.approx(expected[name], rel=1e-9)
    E = rng.standard_normal((6, 6))
    E, h = E + E.T, 1e-5
    up, down = (criterion(name, G + s * h * E)[0] for s in (1, -1))
    assert np.sum(slope * E) == pytest.approx((up - down) / (2 * h), rel=1e-5)


@pytest.mark.parametrize("name", ["irb360-6-1600", "clavel-delta3"])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_gradients_are_exact(exciters, name: str, criterion) -> None:
    problem = exciters[name].problem
    problem = replace(problem, criterion=criterion, velocity_weight=0.3)
    x = random_start(problem, 3)
    here = problem.evaluate(x)
    for k in np.random.default_rng(0).choice(len(x), 10, replace=False):
        e = 1e-6 * np.eye(len(x))[k]
        up, down = problem.evaluate(x + e), problem.evaluate(x - e)
        slope = (up.value - down.value) / 2e-6
        assert here.gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        assert np.allclose(here.slopes[:, k], (up.use - down.use) / 2e-6, rtol=1e-4, atol=1e-5)


def test_series_and_motion_are_the_same_thing(exciters) -> None:
    series = exciters["irb360-6-1600"].problem.series
    x = np.random.default_rng(0).standard_normal(series.length)
    motion = series.motion(x)
    phase = np.linspace(0, 5, 7)
    state = series.state(x, series.basis(phase))
    expected = np.hstack(motion.evaluate(phase / motion.base_frequency)).T
    assert np.allclose(state, expected, rtol=1e-10)


def test_smooth_use_lies_above_the_true_one(exciters) -> None:
    problem = exciters["irb360-6-1600"].problem
    x = random_start(problem, 1)
    smooth, true = problem.evaluate(x, 300.0).use, largest_use(problem, x)
    assert np.all(smooth >= true)
    assert np.all(smooth <= true + np.log(2 * problem.samples) / 300)


def test_torque_limits_are_those_of_the_dynamics(exciters) -> None:
    exciter = exciters["irb360-6-1600"]
    problem, dynamics = exciter.problem, exciter.dynamics
    run = plan_run(problem, problem.series.motion(random_start(problem, 2)), 1)
    z, zd, zdd = run.evaluate(np.linspace(0, run.duration, 1000))
    at = [i for i, name in enumerate(problem.limit_names) if name.endswith("torque")]
    u = problem.use_of(np.hstack([z, zd, zdd]).T)[at].T
    largest = list(problem.largest.values())
    moving = np.abs(dynamics.kinematics.drive_motion(z, zd, zdd)[1]).min(axis=1) > 0.3
    assert moving.sum() > 10
    expected = np.abs(exciter.preview(run, 1000)) / largest
    assert np.allclose(u[moving], expected[moving], atol=0.02)  # the sign of friction is smooth


@pytest.mark.parametrize("seed", swept(range(4), 0, 1))
def test_limits_hold_on_a_grid_ten_times_finer(exciters, seed: int) -> None:
    exciter = exciters["clavel-delta3" if seed % 2 else "irb360-6-1600"]
    problem = exciter.problem
    optimum = optimise(problem, range(seed, seed + 1))
    assert largest_use(problem, optimum.x, 10 * problem.samples).max() <= 1.0
    account = optimum.accounts[0]
    assert account.feasible
    assert account.after < account.before


@pytest.mark.parametrize("name", ["irb360-6-1600", "clavel-delta3"])
def test_a_run_starts_and_ends_at_rest_and_keeps_its_limits(exciters, optima, name: str) -> None:
    exciter, result = exciters[name], optima[name]
    assert all(limit.share <= 1.0 for limit in result.limits)
    assert result.criterion_after < result.criterion_before
    file = sample_run(exciter.dynamics.kinematics, result.run, 1000.0)
    dof = exciter.dynamics.dof
    rates = file.select([f"{n}{i + 1}" for n in ("qd", "qdd") for i in range(dof)]).to_numpy()
    assert np.all(rates[0] == 0)
    assert np.allclose(rates[-1], 0, atol=1e-12)
    time = file["t"].to_numpy()
    for i in range(dof):
        q, qd, qdd = (file[f"{n}{i + 1}"].to_numpy() for n in ("q", "qd", "qdd"))
        assert np.allclose(np.gradient(q, time)[1:-1], qd[1:-1], atol=2e-3 * np.abs(qd).max())
        assert np.allclose(np.gradient(qd, time)[1:-1], qdd[1:-1], atol=2e-2 * np.abs(qdd).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 11, 13])
def test_a_search_that_steps_beyond_its_limits_begins_again_nearer(seed: int) -> None:
    exciter = Exciter(compiled(load_robot("h4")), ExcitationSettings(starts=1, duration=15.0))
    best = optimise(exciter.problem, range(seed, seed + 1)).best
    assert best.after < -3.5  # the random motion itself has 0.5 to 3.4


def test_a_run_repeats_its_periods(exciters) -> None:
    problem = exciters["clavel-delta3"].problem
    run = plan_run(problem, problem.series.motion(random_start(problem, 4)), 3)
    inside = run.ramp + np.linspace(0, run.motion.period, 20)
    for a, b in zip(run.evaluate(inside), run.evaluate(inside + run.motion.period), strict=True):
        assert np.allclose(a, b, atol=1e-9)
    assert run.duration == pytest.approx(2 * run.ramp + 3 * run.motion.period)


def test_same_seed_same_motion_and_other_seeds_another(exciters, optima) -> None:
    exciter, a = exciters["clavel-delta3"], optima["clavel-delta3"]
    b, c = exciter.optimise(), exciter.optimise(offset=1000)
    assert np.array_equal(a.optimum.x, b.optimum.x)
    assert not np.allclose(a.optimum.x, c.optimum.x, atol=1e-3)


def test_a_stopped_search_still_gives_a_feasible_motion(exciters) -> None:
    exciter = exciters["clavel-delta3"]
    stop = Event()
    stop.set()
    result = exciter.optimise(stop)
    assert all(limit.share <= 1.0 for limit in result.limits)


def test_predicted_deviations_are_those_of_repeated_identification(exciters, optima) -> None:
    from deltaid.estimation.information import gather_samples
    from deltaid.identification.least_squares import estimate_base

    exciter = exciters["clavel-delta3"]
    run, samples = optima["clavel-delta3"].run, 1000
    z, zd, zdd = run.evaluate(np.linspace(0, run.duration, samples))
    _, qd, qdd = exciter.dynamics.kinematics.drive_motion(z, zd, zdd)
    tau, rng = exciter.preview(run, samples), np.random.default_rng(0)
    noise = exciter.settings.torque_noise * exciter.torque_reference
    values = []
    for _ in range(80):
        noisy = tau + noise * rng.standard_normal(tau.shape)
        information = gather_samples(exciter.dynamics, z, qd, qdd, noisy)
        values.append(estimate_base(exciter.base, information, "weighted").values)
    spread = np.std(values, axis=0)
    thinner = np.sqrt(run.duration * exciter.settings.rate / samples)
    predicted = thinner * np.array([p.std for p in exciter.predict(run)])
    assert np.median(spread / predicted) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_weighing_the_prior_attends_to_what_it_knows_least(exciters, optima) -> None:
    dynamics, plain = exciters["clavel-delta3"].dynamics, optima["clavel-delta3"]
    exciter = Exciter(dynamics, ExcitationSettings(starts=2, weigh_prior=True))
    assert not np.allclose(plain.optimum.x, exciter.optimise().optimum.x, atol=1e-3)


def test_prior_and_recording_weigh_as_in_a_posterior(exciters, optima) -> None:
    """What is optimised is the precision of both together for each sample, written out here."""
    plain, x, n = exciters["clavel-delta3"], optima["clavel-delta3"].optimum.x, 200
    dynamics, layout = plain.dynamics, plain.base.layout
    asked = ExcitationSettings(weigh_prior=True, duration=8.0, rate=500.0, torque_noise=0.03)
    exciter = Exciter(dynamics, asked)
    motion = exciter.problem.series.state(x, exciter.problem.grid(n)).reshape(3, 3, n)
    z, zd, zdd = np.swapaxes(motion, 1, 2)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    Y = np.zeros((3, len(layout.names), n))
    Y[dynamics.regressor_pattern] = dynamics.sparse_regressor(z, qd, qdd, 0 * z).values
    Y /= 0.03 * exciter.torque_reference[:, None, None]
    rows = np.swapaxes(Y[:, [group.representative for group in exciter.base.groups]], 1, 2)
    rows = rows.reshape(3 * n, -1)
    prior = 0.5 * np.array([parameter.scale for parameter in layout.parameters])
    of_prior = np.sum((exciter.base.combination() * prior) ** 2, axis=1)
    precision = rows.T @ rows * (8.0 * 500.0 / n) + np.diag(1 / of_prior)
    scale = np.sqrt(of_prior)
    np.testing.assert_allclose(
        8.0 * 500.0 * exciter.problem.information(x, n),
        precision * np.outer(scale, scale),
        rtol=1e-7,
        atol=1e-7,
    )


def test_a_rate_that_does_not_show_the_motion_is_refused() -> None:
    for rate in (1.0, 39.0):
        with pytest.raises(DeltaidError, match=f"{rate:g} Hz does not show .* 2 Hz\n.* 40 Hz"):
            Exciter("clavel-delta3", ExcitationSettings(rate=rate))


def test_a_picture_without_matplotlib_is_refused_before_any_work(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    message = refused("excite", "clavel-delta3", "--plot", tmp_path / "x.svg", folder=tmp_path)
    assert "pip install matplotlib" in message


@pytest.mark.parametrize(
    ("command", "option", "kind"),
    [
        ("excite", "--criterion", CriterionName),
        ("simulate", "--controller", ControllerName),
        ("export", "--to", TargetName),
        ("identify", "--method", Method),
    ],
)
def test_choices_of_the_command_line_are_those_of_the_package(command, option, kind) -> None:
    outcome = run(command, "clavel-delta3", "log.csv", option, "nothing")
    assert outcome.code == 2
    message = "".join(outcome.err.replace("│", "").split())
    assert ",".join(f"'{name}'" for name in get_args(kind)) in message
