"""Intervals of single parameters: what torques cannot see is the prior's; none is below zero."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy import stats

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation import ranges as ranges_module
from deltaid.estimation.scatter import Scatter
from deltaid.identification.identify import Identification, identify
from deltaid.identification.uncertainty import ConsistentRanges, Uncertainty, uncertainty
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel
from deltaid.robot.load import load_robot
from identified import simulated
from poor_priors import PLAIN

ROBOT = "irb360-6-1600"
DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def case() -> tuple[Identification, dict[str, float]]:
    """A robot with twice the prior's friction, an arm 40 % heavier, and a tool 40 % heavier at the
    cost of the platform. Torques show the friction only."""
    robot = load_robot(ROBOT)
    dynamics = compiled(robot)
    names, p = dynamics.layout.names, prior_parameters(robot)
    at = {name: i for i, name in enumerate(names)}
    moved = 0.4 * p[at["EE.m"]]
    p[at["U.m"]] *= 1.4
    p[at["P.m"]] -= moved
    p[at["EE.m"]] += moved
    p[dynamics.layout.friction] *= 2
    recording = simulated(robot, p, 2, duration=10.0, rate=1000.0)
    return identify(robot, recording, settings=PLAIN), dict(zip(names, p.tolist(), strict=True))


def bounds(parameter: Parameter) -> tuple[float, float]:
    assert parameter.low is not None
    assert parameter.high is not None
    return parameter.low, parameter.high


def test_what_torques_cannot_see_is_from_the_prior_and_not_excluded(case) -> None:
    result, truth = case
    found = {parameter.name: parameter for parameter in result.model.parameters}
    for name in ("U.m", "P.m", "EE.m"):
        parameter = found[name]
        low, high = bounds(parameter)
        assert parameter.determined_by == "prior"
        assert low <= truth[name] <= high, name
        assert parameter.std == pytest.approx(0.5 * parameter.prior)
        assert low <= 0.05 * parameter.prior
        assert high >= 1.95 * parameter.prior


def test_friction_is_from_the_data_and_within_its_interval(case) -> None:
    result, truth = case
    friction = [p for p in result.model.parameters if p.name.startswith(("viscous", "coulomb"))]
    assert {parameter.determined_by for parameter in friction} == {"data"}
    within = [bounds(p)[0] <= truth[p.name] <= bounds(p)[1] for p in friction]
    assert sum(within) >= len(friction) - 1
    assert all(bounds(p)[1] - bounds(p)[0] < 0.5 * p.value for p in friction)


@pytest.mark.parametrize("prior_spread", [pytest.param(0.5, marks=pytest.mark.slow), 3.0])
def test_no_mass_moment_or_friction_reaches_below_zero(prior_spread: float) -> None:
    robot = load_robot("clavel-delta3")
    p = prior_parameters(robot)
    p[compiled(robot).layout.coulomb] = 1e-4  # far below what the noise lets one see
    recording = simulated(robot, p, 0, 0.1, duration=5.0, rate=1000.0)
    settings = PLAIN.changed(prior_spread=prior_spread)
    model = identify(robot, recording, settings=settings).model
    signed = ("mcx", "mcy", "mcz", "Ixy", "Iyz", "Ixz")
    for parameter in model.parameters:
        low, high = bounds(parameter)
        assert low <= parameter.value <= high
        if not parameter.name.endswith(signed):
            assert low >= 0, parameter.name


def test_model_file_keeps_intervals_and_base_parameters(case, tmp_path: Path) -> None:
    result, _ = case
    result.model.save(tmp_path / "model.yaml")
    loaded = IdentifiedModel.load(tmp_path / "model.yaml")
    assert loaded.parameters == result.model.parameters
    assert loaded.base_parameters == result.model.base_parameters
    assert [b.formula for b in loaded.base_parameters] == list(result.problem.base.formulas)
    half = [0.5 * (b.high - b.low) for b in loaded.base_parameters]
    assert np.allclose(half, result.problem.estimate.interval)


def test_degrees_of_freedom_are_those_of_the_part_that_noise_adds(case) -> None:
    """Welch and Satterthwaite: σ² = σ_n² + σ_p², σ_n² estimated with ν_n degrees of freedom, has
    ν = ν_n σ⁴/σ_n⁴ of them. Twice the noise level in the same problem tells σ_n apart."""
    problem, freedom = case[0].problem, 3.0

    def with_noise(level: float) -> Uncertainty:
        noise = replace(problem.estimate.noise, sigma=level, freedom=freedom, scatter=None)
        return uncertainty(
            replace(problem, least_squares=replace(problem.least_squares, noise=noise))
        )

    sigma = 20 * problem.noise  # noise and prior then matter both, here or there
    single, doubled = with_noise(sigma), with_noise(2 * sigma)
    by_noise = (doubled.std**2 - single.std**2) / 3
    share = by_noise / np.maximum(single.std**2, 1e-300)
    mixed = (share > 0.1) & (share < 0.9)
    assert mixed.sum() >= 5
    expected = stats.t.ppf(0.975, freedom / share[mixed] ** 2)
    np.testing.assert_allclose(single.interval[mixed] / single.std[mixed], expected, rtol=1e-6)


def test_model_file_of_format_1_loads() -> None:
    loaded = IdentifiedModel.load(DATA / "model-format-1.yaml")
    assert loaded.format == 1
    assert loaded.p.sum() == pytest.approx(20.7274197539394, rel=1e-14)
    assert loaded.base_parameters[0].representative == ""
    assert loaded.fit.nrmse[1] == 0.0047055381230269875


def test_model_file_of_an_earlier_version_loads(case, tmp_path: Path) -> None:
    result, _ = case
    path, yaml = tmp_path / "model.yaml", YAML(typ="safe")
    result.model.save(path)
    content = yaml.load(path)
    del content["base_parameters"]
    for parameter in content["parameters"]:
        del parameter["low"], parameter["high"]
    yaml.dump(content, path)
    loaded = IdentifiedModel.load(path)
    assert np.array_equal(loaded.p, result.model.p)
    assert loaded.base_parameters == ()
    assert loaded.parameters[0].low is None


def test_variances_from_few_groups_are_unbiased_with_the_freedom_that_they_say() -> None:
    # White noise of level one in four groups of unequal share. What the fit takes of each group's
    # own noise makes the groups scatter less, by more than a quarter of all with so few of them.
    rng, n, draws = np.random.default_rng(0), 3, 4000
    rows = [rng.standard_normal((m, n)) for m in (4, 6, 9, 15)]
    L = np.linalg.cholesky(sum(A.T @ A for A in rows))
    rows = [np.linalg.solve(L, A.T).T for A in rows]  # their shares add up to one
    shares = np.stack([A.T @ A for A in rows])
    own = np.stack([rng.standard_normal((draws, len(A))) @ A for A in rows])
    scores = own - own.sum(axis=0) @ shares  # of the residuals, group by group
    U = np.array([[3.0], [-2.0], [1.0]])
    found = [Scatter(shares, scores[:, k]).variances(U) for k in range(draws)]
    v, freedom = np.array([variances[0][0] for variances in found]), found[0][1][0]
    assert v.mean() == pytest.approx(np.sum(U**2), rel=0.05)
    assert 2 * v.mean() ** 2 / v.var() == pytest.approx(freedom, rel=0.1)


@pytest.mark.parametrize(("gap", "is_known"), [(1e-4, True), (1e-2, False)])
def test_an_end_counts_where_rounding_stops_the_solver_at_it(
    case, monkeypatch: pytest.MonkeyPatch, gap: float, is_known: bool
) -> None:
    result, _ = case
    problem = result.problem
    c = np.eye(len(problem.values))[problem.layout.names.index("coulomb.drive1")]
    expected = ConsistentRanges(problem).ends(c)
    solve = ranges_module.interior_point

    def stopped(*arguments: object) -> SimpleNamespace:
        end = solve(*arguments)
        bound = end.obj_val - gap * max(1.0, abs(end.obj_val))
        return SimpleNamespace(
            status="InsufficientProgress", obj_val=end.obj_val, obj_val_dual=bound
        )

    monkeypatch.setattr(ranges_module, "interior_point", stopped)
    ends = ConsistentRanges(problem).ends(c)
    assert np.all(np.isfinite(ends)) == is_known
    if is_known:
        np.testing.assert_allclose(ends, expected, rtol=1e-3)
