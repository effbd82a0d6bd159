"""Models drawn from a posterior: consistent, of the right distribution, reproducible, refused where
they could not be trusted. The reference is rejection from the normal distribution, which needs
nothing but the numbers of the model file."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scipy import stats

import deltaid
from deltaid.checks.identify import Judged
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import least_margin, prior_parameters
from deltaid.errors import DeltaidError, IdentificationError
from deltaid.estimation import posterior_draws
from deltaid.estimation.posterior_density import Chains, Density, density
from deltaid.estimation.posterior_draws import effective_size, rhat
from deltaid.identification.judgement import base_covariance
from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.model.samples import Samples
from identified import identified
from posteriors import by_rejection, hasten, matrices, normal
from support import along

# How often a right sampler fails: another processor rounds to another seed, as it were.
BY_CHANCE = 1e-6


@pytest.fixture(scope="module")
def judged() -> Judged:
    return identified("stout").result


@pytest.fixture(scope="module")
def model(judged) -> IdentifiedModel:
    return judged.model


@pytest.fixture(scope="module")
def drawn(model) -> Samples:
    return model.sample(8000)


@pytest.fixture(scope="module")
def tight(model) -> IdentifiedModel:
    """The same data under a tighter prior, so that rejection finds enough."""
    return model.changed(posterior=model.posterior.changed(spread=0.25))


def test_draws_are_those_of_rejection(tight: IdentifiedModel) -> None:
    expected = by_rejection(tight, 3000, np.random.default_rng(5))
    drawn = tight.sample(3000, seed=1)
    varies = expected.std(axis=0) > 1e-9 * np.abs(expected).max(axis=0)
    np.testing.assert_array_equal(varies, drawn.p.std(axis=0) > 0)
    chance = [
        stats.ks_2samp(a, b).pvalue
        for a, b in zip(expected[:, varies].T, drawn.p[:, varies].T, strict=True)
    ]
    assert min(chance) > BY_CHANCE / len(chance)
    rng = np.random.default_rng(0)  # sums feel correlations
    sums = rng.standard_normal((20, varies.sum())) / expected[:, varies].std(axis=0)
    chance = [stats.ks_2samp(expected[:, varies] @ c, drawn.p[:, varies] @ c).pvalue for c in sums]
    assert min(chance) > BY_CHANCE / len(chance)


def test_a_factor_beside_the_normal_distribution(tight: IdentifiedModel) -> None:
    """A factor exp(cᵀx): the mean moves by the covariance · c."""
    plain, rng = density(tight), np.random.default_rng(3)
    n = plain.reduction.size
    along = np.zeros(n)
    along[:3] = 1.5  # standard deviations
    c = np.linalg.solve(plain.root.T, along)
    tilted = replace(plain, rest=lambda x: x @ c)
    chains = Chains(tilted, 256, np.random.default_rng(4))
    chains.walk(60)
    draws = []
    for _ in range(8):
        chains.walk(60)  # so that draws are as independent as the test below takes them to be
        draws.append(chains.y)
    drawn = np.vstack(draws)
    y = along + rng.standard_normal((300_000, n))
    inside = plain.cones.hold(plain.cones.constant[:, None] + plain.cones.slopes @ y.T)
    expected = y[inside][:3000]
    assert len(expected) == 3000
    chance = [stats.ks_2samp(a, b).pvalue for a, b in zip(drawn.T, expected.T, strict=True)]
    assert min(chance) > 0.01 / n


@pytest.mark.parametrize("regularizer", ["euclidean", "entropic", "riemannian"])
def test_the_density_is_that_of_data_and_metric(
    model: IdentifiedModel, drawn: Samples, regularizer: str
) -> None:
    """log π by the numbers of the model file, but for a constant."""
    settings = model.settings.changed(regularizer=regularizer, method="log-cholesky")
    known = density(model.changed(settings=settings))
    record, prior = model.posterior, prior_parameters(model.robot)
    assert record is not None
    p = drawn.p[:40]
    y = np.array([inverted(known, each) for each in p])
    np.testing.assert_allclose(known.parameters(y), p, rtol=1e-7, atol=1e-12)
    rho, moved = np.zeros(len(p)), p.std(axis=0) > 0
    for b in range(len(model.layout.bodies)):
        part = slice(10 * b, 10 * b + 10)
        if regularizer == "euclidean":
            size = np.where(prior[part] != 0, np.abs(prior[part]), sizes(prior[part]))
            off = (p[:, part] - prior[part]) / size
            rho += np.sum(np.where(moved[part], off, 0.0) ** 2, axis=1)
        else:
            root = np.linalg.inv(np.linalg.cholesky(matrices(prior[None, part])[0]))
            lam = np.linalg.eigvalsh(root @ matrices(p[:, part]) @ root.T)
            rho += divergence(regularizer, lam).sum(axis=1)
    joints = slice(10 * len(model.layout.bodies), len(prior))
    rho += divergence(regularizer, p[:, joints] / prior[joints]).sum(axis=1)
    K = np.array([[row.get(name, 0.0) for name in model.layout.names]
                  for row in record.combinations])  # fmt: skip
    left = np.linalg.solve(record.root, K @ p.T - np.array(record.values)[:, None])
    expected = -0.5 * np.sum(left**2, axis=0) - rho / (2 * record.spread**2)
    found = known.log_factor(y) - 0.5 * np.sum(y**2, axis=1)
    np.testing.assert_allclose(
        found - found[0], expected - expected[0], rtol=1e-6, atol=1e-5 * np.ptp(expected)
    )


def inverted(known: Density, p: np.ndarray) -> np.ndarray:
    """y of some p."""
    A = known.reduction.A
    x = np.linalg.lstsq(A / known.reduction.scale.max(), p - known.reduction.p_0, rcond=None)[0]
    return np.linalg.solve(known.root, x / known.reduction.scale.max() - known.mean)


def divergence(name: str, lam: np.ndarray) -> np.ndarray:
    if name == "euclidean":
        return (lam - 1) ** 2
    return 2 * (lam - 1 - np.log(lam)) if name == "entropic" else np.log(lam) ** 2


def sizes(p: np.ndarray) -> np.ndarray:
    m, second = p[0], 0.5 * p[4:7].sum()
    return m * np.array([1.0, *[np.sqrt(second / m)] * 3, *[second / m] * 6])


def test_all_are_consistent(model: IdentifiedModel, drawn: Samples) -> None:
    assert min(least_margin(model.layout, p)[1] for p in drawn.p[:200]) > 0
    assert drawn.ess.min() > 0.5 * len(drawn) == 4000
    assert drawn.rhat.max() < 1.05


def test_models_are_the_same_for_a_seed(model: IdentifiedModel, monkeypatch) -> None:
    hasten(monkeypatch)
    whole = load(identified("stout").model_file)
    drawn = whole.sample(60, seed=4)
    np.testing.assert_array_equal(drawn.p, model.sample(60, seed=4).p)
    assert not np.array_equal(drawn.p, model.sample(60, seed=5).p)
    models = list(drawn.models())
    assert len(models) == len(drawn) == 60
    assert isinstance(models[7], Model)
    np.testing.assert_array_equal(models[7].p, drawn.p[7])
    np.testing.assert_array_equal(models[7].as_description().bodies["P"].prior_parameters()[0],
                                  drawn.p[7, drawn.names.index("P.m")])  # fmt: skip


@pytest.mark.parametrize("drive", ["drive2", "drive3"])
@pytest.mark.parametrize("kind", ["viscous", "coulomb"])
def test_where_data_decides_models_spread_as_the_intervals(
    model: IdentifiedModel, drawn: Samples, kind: str, drive: str
) -> None:
    """The prior takes up to 8 % of an interval, and edges of what is consistent up to 8 % more:
    most where an effect that may act widens it, for edges cut what that would change.

    Chains are others on another processor, and 8000 draws, worth half as many independent ones,
    know a deviation to 1.1 %: 12 % are four times that and the edges' part.
    """
    name = f"{kind}.{drive}"
    at = model.layout.names.index(name)
    (base,) = (base for base in model.base_parameters if base.representative == name)
    interval = (base.high - base.low) / (2 * stats.norm.ppf(0.975))
    expected = float(np.linalg.norm(normal(model).spread[at]))
    assert 0.9 * interval < expected < interval
    assert drawn.p[:, at].std() == pytest.approx(expected, rel=0.12)


def test_the_record_has_the_deviations_of_the_intervals(judged: Judged) -> None:
    """But for a constant of friction that its laws lack: models with its weight would need it."""
    problem = judged.problem.with_own_friction
    assert np.all(problem.estimate.interval <= judged.problem.estimate.interval)
    weight = problem.estimate.interval < 0.9 * judged.problem.estimate.interval
    assert any("mc" in formula for formula in np.array(problem.base.formulas)[weight])
    V = base_covariance(problem)
    half = stats.norm.ppf(0.975) * np.sqrt(np.diag(V))
    np.testing.assert_allclose(half, problem.estimate.interval, rtol=5e-3)
    record = judged.model.posterior
    np.testing.assert_allclose(record.root @ record.root.T, V, rtol=1e-3)
    K = problem.base.combination()
    np.testing.assert_allclose(record.combination(judged.model.layout.names), K, atol=1e-7)
    assert problem.with_own_friction is problem


def test_limbs_scatter_about_what_they_share(model: IdentifiedModel, monkeypatch) -> None:
    hasten(monkeypatch)
    tolerance = 0.05
    shared, own = model.sample(1000, seed=1), model.sample(1000, seed=1, limb_tolerance=tolerance)
    assert not own.robot.limbs.identical
    at = {name: i for i, name in enumerate(own.names)}
    for name in ("U.m", "U.mcx", "U.Iyy", "S.m", "S.Ixx"):
        body, entry = name.split(".")
        limbs = own.p[:, [at[f"{body}{i}.{entry}"] for i in (1, 2, 3)]]
        whole = shared.p[:, shared.names.index(name)]
        np.testing.assert_allclose(limbs.mean(axis=1), whole, rtol=1e-9)
        if entry == "m":
            scatter = (limbs / whole[:, None]).std(axis=0)
            np.testing.assert_allclose(scatter, tolerance, rtol=0.12)  # five standard errors
    for drawn in islice(own.models(), 10):
        assert least_margin(drawn.layout, drawn.p)[1] > 0
    with pytest.raises(DeltaidError, match=r"limb_tolerance: must lie between 0 and 0\.3"):
        model.sample(10, limb_tolerance=0.5)


def test_torques_of_drawn_models_hold_what_is_recorded(
    model: IdentifiedModel, drawn: Samples
) -> None:
    """On another motion: the torque without noise lies within the models' range at its rate."""
    dynamics, rng = compiled(model.robot), np.random.default_rng(11)
    z, q, qd, qdd = along(dynamics.kinematics, rng, 200)
    tau = dynamics.inverse_dynamics(q, qd, qdd, identified("stout").p)
    level = model.fit.noise_level * np.abs(tau).max(axis=0)
    measured = tau + level * rng.standard_normal(tau.shape)
    predicted = np.array([dynamics.torque(z, qd, qdd, p) for p in drawn.p[:300]])
    parameters_alone = predicted.std(axis=0)
    assert np.all(np.sqrt(np.mean(parameters_alone**2, axis=0)) < 0.5 * level)
    predicted += level * rng.standard_normal(predicted.shape)
    low, high = np.quantile(predicted, [0.025, 0.975], axis=0)
    share = np.mean((measured > low) & (measured < high))
    assert 0.92 < share < 0.98


def test_diagnostics_of_known_chains() -> None:
    rng = np.random.default_rng(0)
    white = rng.standard_normal((1000, 20, 3))
    assert np.all(rhat(white) < 1.01)
    np.testing.assert_allclose(effective_size(white), 20_000, rtol=0.15)
    slow, memory = white.copy(), 0.9
    for k in range(1, len(slow)):
        slow[k] = memory * slow[k - 1] + np.sqrt(1 - memory**2) * white[k]
    expected = 20_000 * (1 - memory) / (1 + memory)
    np.testing.assert_allclose(effective_size(slow), expected, rtol=0.25)
    apart = white + np.arange(20)[:, None] / 10
    assert np.all(rhat(apart) > 1.05)
    wider = white * np.where(np.arange(20) < 10, 1.0, 3.0)[:, None]
    assert np.all(rhat(wider) > 1.05)


def test_draws_that_cannot_be_trusted_are_refused(
    model: IdentifiedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    hasten(monkeypatch)
    monkeypatch.setattr(posterior_draws, "_LARGEST_RHAT", 1.0)
    with pytest.raises(IdentificationError, match="chains that draw models do not agree"):
        model.sample(10)


def test_intervals_of_drawn_models(model: IdentifiedModel, monkeypatch) -> None:
    hasten(monkeypatch)
    monkeypatch.setattr(posterior_draws, "_MODELS", 100)
    settings, linear, p = deltaid.Settings(intervals="posterior"), model, model.sample(100).p
    known = identified("stout")
    posterior = deltaid.identify(known.robot, known.log, settings=settings).model
    assert (linear.settings.intervals, posterior.settings.intervals) == ("linear", "posterior")
    for i, (a, b) in enumerate(zip(linear.parameters, posterior.parameters, strict=True)):
        assert (a.value, a.determined_by) == (b.value, b.determined_by)
        if p[:, i].std() > 0:
            low, high = np.quantile(p[:, i], [0.025, 0.975])
            assert (b.low, b.high) == pytest.approx((min(low, b.value), max(high, b.value)))
            assert b.std == pytest.approx(p[:, i].std(), rel=1e-9)
        else:
            assert a == b
    from deltaid.view.model_tables import parameter_table

    assert parameter_table(posterior).title.endswith("intervals: posterior")
    assert "intervals" not in parameter_table(linear).title
