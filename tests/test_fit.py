"""The two solvers of (15), the parametrisation behind one of them, and the regularisers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import IdentificationError
from deltaid.estimation import conic
from deltaid.estimation.conic import Conic
from deltaid.estimation.information import Information, active_columns, gather_samples
from deltaid.estimation.log_cholesky import LogCholesky, LogCholeskyMap, Unconstrained
from deltaid.estimation.objective import METRICS, Objective, data_term, default_gamma, noise_level
from deltaid.estimation.objective import regularizer as prior_term
from deltaid.estimation.reduction import build_reduction
from deltaid.levels import FAINT
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import consistency, pseudo_inertia
from deltaid.robot.load import load_robot
from support import along

numbers = st.floats(-1.5, 1.5)


def information(dynamics: Dynamics, truth: np.ndarray, noise: float) -> Information:
    rng = np.random.default_rng(0)
    z, _, qd, qdd = along(dynamics.kinematics, rng, 1500)
    tau = dynamics.torque(z, qd, qdd, truth)
    tau = tau + noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    return gather_samples(dynamics, z, qd, qdd, tau)


def problem(
    name: str = "irb360-6-1600", regularizer="euclidean", noise: float = 0.02, gamma=None
) -> Objective:
    robot = load_robot(name)
    dynamics = compiled(robot)
    truth = surrogate_parameters(robot, np.random.default_rng(5))
    data = information(dynamics, truth, noise)
    reduction = build_reduction(robot, data.columns)
    weight = gamma or default_gamma(data, 0.5)
    metric = prior_term(reduction, METRICS[regularizer])
    return Objective(reduction, data_term(data, reduction), metric, weight)


def freed(robot: RobotDescription, body: str, entries: tuple[str, ...]) -> RobotDescription:
    changed = robot.bodies[body].changed(free=entries)
    return robot.model_copy(update={"bodies": robot.bodies | {body: changed}})


@given(pi=st.lists(numbers, min_size=10, max_size=10))
@settings(max_examples=50, deadline=None)
def test_log_cholesky_of_a_free_body_is_equation_14(pi: list[float]) -> None:
    """Against the closed form (14) with its misprints mended, typed here and nowhere else."""
    chart = free_body_chart()
    at = [k for k, v in enumerate(chart.reduction.variables) if v.owner == "EE"]
    full = chart.pi(chart.reduction.prior)
    full[at] = pi
    x = chart.x(full) - FAINT * chart.reduction.prior
    a, t1, t2, t3, d1, d2, d3, s12, s23, s13 = pi
    e1, e2, e3 = np.exp([d1, d2, d3])
    p = np.exp(2 * a) * np.array([
        t1**2 + t2**2 + t3**2 + 1,
        t1 * e1, t1 * s12 + t2 * e2, t1 * s13 + t2 * s23 + t3 * e3,
        s12**2 + s23**2 + s13**2 + e2**2 + e3**2, s13**2 + s23**2 + e1**2 + e3**2,
        s12**2 + e1**2 + e2**2,
        -s12 * e1, -s12 * s13 - s23 * e2, -s13 * e1,
    ])  # fmt: skip
    part = chart.reduction.layout.body("EE")
    ours = (chart.reduction.A @ x)[part]
    assert np.allclose(ours, p, rtol=1e-10, atol=1e-12 * np.abs(p).max())


def free_body_chart() -> LogCholeskyMap:
    robot = load_robot("irb360-6-1600")
    everything = ("m", "mcx", "mcy", "mcz", "Sxx", "Syy", "Szz", "Sxy", "Syz", "Sxz")
    robot = freed(robot, "EE", everything)
    return LogCholeskyMap(build_reduction(robot, active_columns(compiled(robot))))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_log_cholesky_is_one_to_one_and_always_consistent(seed: int) -> None:
    reduction = PROBLEM.reduction
    chart = LogCholeskyMap(reduction)
    rng = np.random.default_rng(seed)
    pi = chart.pi(reduction.prior) + rng.uniform(-1, 1, reduction.size)
    x = chart.x(pi)
    assert np.allclose(chart.pi(x), pi, atol=1e-6)
    p = reduction.parameters(x)
    for body in reduction.layout.bodies:
        assert consistency(p[reduction.layout.body(body)]) > 0
    assert np.all(p[10 * len(reduction.layout.bodies) :] > 0)


PROBLEM = problem()


def test_optimisation_variables_are_those_of_section_vi() -> None:
    reduction = PROBLEM.reduction
    of = [variable.owner for variable in reduction.variables]
    counts = {body: of.count(body) for body in reduction.layout.bodies}
    assert counts == {"U": 4, "S": 5, "P": 1, "TU": 5, "TL": 5, "EE": 5}
    kinds = [variable.kind for variable in reduction.variables]
    assert kinds.count("rotor") == 1
    assert kinds.count("friction") == 10
    assert reduction.size == 36


def test_log_cholesky_derivatives_are_exact() -> None:
    reduction = PROBLEM.reduction
    chart, rng = LogCholeskyMap(reduction), np.random.default_rng(0)
    pi = chart.pi(reduction.prior) + 0.3 * rng.standard_normal(reduction.size)
    weights, step = rng.standard_normal(reduction.size), 1e-5
    _, J, H = chart.derivatives(pi, weights)
    for k in rng.choice(reduction.size, 8, replace=False):
        e = step * np.eye(reduction.size)[k]
        slope = (chart.x(pi + e) - chart.x(pi - e)) / (2 * step)
        assert np.allclose(J[:, k], slope, rtol=1e-6, atol=1e-8)
        up, down = (weights @ chart.derivatives(pi + s * e, weights)[1] for s in (1, -1))
        assert np.allclose(H[:, k], (up - down) / (2 * step), rtol=1e-5, atol=1e-7)


@pytest.mark.filterwarnings("error")
def test_where_an_exponential_overflows_the_objective_is_infinite() -> None:
    # A line search may try steps of any length; NaN would pass every "not larger than" it asks.
    objective = problem()
    reduction = objective.reduction
    chart = LogCholeskyMap(reduction)
    start, rng = chart.pi(reduction.prior), np.random.default_rng(0)
    function = Unconstrained(objective, chart)
    for length in (1e3, 1e6, 1e300):
        assert function.value(start + length * rng.standard_normal(len(start))) == np.inf
    assert np.isclose(function.value(start), objective.value(reduction.prior) / objective.gamma)


@pytest.mark.parametrize("name", METRICS)
def test_regulariser_derivatives_are_exact(name) -> None:
    reduction = PROBLEM.reduction
    regularizer = prior_term(reduction, METRICS[name])
    chart, rng = LogCholeskyMap(reduction), np.random.default_rng(1)
    x = chart.x(chart.pi(reduction.prior) + 0.2 * rng.standard_normal(reduction.size))
    _, g, H = regularizer.evaluate(x)
    for k in range(reduction.size):
        e = 1e-5 * abs(x[k]) * np.eye(reduction.size)[k]
        h = e[k]
        up, down = regularizer.evaluate(x + e), regularizer.evaluate(x - e)
        assert np.isclose(g[k], (up[0] - down[0]) / (2 * h), rtol=1e-5, atol=1e-6 * abs(g).max())
        slope = (up[1] - down[1]) / (2 * h)
        assert np.allclose(H[:, k], slope, rtol=1e-4, atol=1e-6 * np.abs(H[:, k]).max())


@pytest.mark.parametrize("name", METRICS)
def test_regularisers_agree_for_a_small_common_scale(name) -> None:
    reduction = PROBLEM.reduction
    regularizer = prior_term(reduction, METRICS[name])
    assert regularizer.evaluate(reduction.prior)[0] == pytest.approx(0, abs=1e-15)
    friction = [i for i, v in enumerate(reduction.variables) if v.symbol == "viscous"]
    x = reduction.prior.copy()
    x[friction] *= 1.001
    assert regularizer.evaluate(x)[0] == pytest.approx(1e-6 * len(friction), rel=2e-3)


@pytest.mark.parametrize("regularizer", ["euclidean", "entropic"])
def test_no_consistent_neighbour_is_better_than_the_conic_optimum(regularizer) -> None:
    objective = problem(regularizer=regularizer, gamma=1e-7)
    reduction = objective.reduction
    best = Conic().solve(objective)
    assert best.duality_gap <= 1e-6 * best.objective
    chart, rng = LogCholeskyMap(reduction), np.random.default_rng(2)
    pi = chart.pi(best.x + 1e-3 * (reduction.prior - best.x))
    for size in (1e-4, 1e-3, 1e-2, 0.1):
        for _ in range(20):
            x = chart.x(pi + size * rng.standard_normal(reduction.size))
            assert objective.value(x) >= best.bound


@pytest.mark.parametrize("regularizer", ["euclidean", "entropic"])
@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600"])
def test_both_solvers_find_the_same_optimum(name: str, regularizer) -> None:
    objective = problem(name, regularizer, gamma=1e-5)
    certified = Conic().solve(objective)
    paper = LogCholesky().solve(objective)
    assert paper.objective == pytest.approx(certified.objective, rel=1e-6)
    assert paper.objective >= certified.bound - 1e-9 * abs(certified.bound)


def test_an_interior_optimum_needs_no_cone_and_the_cone_program_agrees() -> None:
    objective = problem(gamma=100.0)
    reduction = objective.reduction
    direct = Conic().solve(objective)
    assert direct.status == "interior optimum"
    program = conic._Program(objective, conic._stacked(objective), Conic())
    solution = program.solve()
    assert solution.objective == pytest.approx(direct.objective, rel=1e-7)
    assert np.allclose(solution.x / reduction.scale, direct.x / reduction.scale, atol=0.1)


def test_a_binding_cone_is_respected_and_certified() -> None:
    """A prior far off and little weight on it drives a strut's second moments to the edge."""
    objective = problem(noise=0.2, gamma=1e-9)
    reduction = objective.reduction
    quadratic = conic._stacked(objective)
    unconstrained = np.linalg.solve(quadratic.R, quadratic.b)
    blocks = (block.normalised_at(unconstrained) for block in reduction.blocks)
    assert min(np.linalg.eigvalsh(block)[0] for block in blocks) <= FAINT
    best = Conic().solve(objective)
    assert objective.value(unconstrained) < best.objective
    assert best.duality_gap <= 1e-5 * best.objective
    p = reduction.parameters(best.x)
    for body in reduction.layout.bodies:
        assert np.linalg.eigvalsh(pseudo_inertia(p[reduction.layout.body(body)]))[0] > 0


def test_the_riemannian_distance_has_no_conic_program() -> None:
    objective = problem(regularizer="riemannian")
    with pytest.raises(IdentificationError, match="not convex"):
        Conic().solve(objective)


def test_patterns_that_a_cholesky_factor_fills_in_are_refused() -> None:
    robot = freed(load_robot("irb360-6-1600"), "S", ("m", "mcx", "Sxx", "Syy", "Szz", "Sxy"))
    reduction = build_reduction(robot, active_columns(compiled(robot)))
    with pytest.raises(IdentificationError, match="mcy"):
        LogCholeskyMap(reduction)


def test_a_mass_that_torques_cannot_see_grows_until_the_body_is_consistent() -> None:
    reduction = PROBLEM.reduction
    x = reduction.prior.copy()
    x[reduction.names.index("U.mcx")] *= 4
    p = reduction.parameters(x)
    assert p[0] > 4 * reduction.p_reg[0]
    assert consistency(p[reduction.layout.body("U")]) > 0
    assert reduction.parameters(reduction.prior)[0] == reduction.p_reg[0]


@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_noise_level_is_the_noise_put_in(noise: float) -> None:
    robot = load_robot("clavel-delta3")
    truth = surrogate_parameters(robot, np.random.default_rng(0))
    data = information(compiled(robot), truth, noise)
    # W_τ normalises by the largest noisy torque, which exceeds the largest true one.
    assert noise_level(data) == pytest.approx(noise, rel=0.15)
    gamma = noise_level(data) ** 2 / data.samples
    assert default_gamma(data, 1.0) == pytest.approx(gamma, rel=1e-12)
    assert default_gamma(data, 0.5) == pytest.approx(4 * default_gamma(data, 1.0), rel=1e-12)


def test_more_weight_on_the_prior_moves_the_result_towards_it() -> None:
    objective = PROBLEM
    reduction = objective.reduction
    distances = []
    for gamma in (1e-8, 1e-4, 1.0, 1e4):
        x = Conic().solve(replace(objective, gamma=gamma)).x
        distances.append(np.linalg.norm((x - reduction.prior) / reduction.scale))
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 1e-3
