"""Models drawn from posteriors: time, agreement with another sampler, spread, coverage.

    pip install -e '.[test,benchmark]'
    python benchmarks/posterior.py [ROBOTS]

For surrogates of catalogue robots, identified from a demo's recording each: time for 1000 models on
one core; whether all are consistent; two-sample tests of all parameters against a long walk of
another kind (hit and run, straight lines through the cones, from the numbers of the model file
alone); spread of base parameters that prior and cones leave alone over that of their intervals;
and how often the torques of another motion, noise and all, lie within 95 % of what drawn models
predict. Leaves `tables/posterior.md`.
"""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import _alone  # noqa: F401
import numpy as np
from _table import leave
from scipy import stats
from scipy.linalg import inv
from scipy.special import ndtr, ndtri

from deltaid.dynamics.parameters import least_margin
from deltaid.identification.demo import demonstrate
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel
from deltaid.robot.load import load_robot
from posteriors import Normal, matrices, normal
from support import along

ROBOTS = ("clavel-delta3", "linear-delta", "par4", "irb360-6-1600")
HEAD = (
    "robot", "free", "1000 models, s", "worth", "R̂", "inconsistent", "least p-value, of so many",
    "spread / interval", "torques covered",
)  # fmt: skip
# Of the walk: chains, steps before the first draw and between draws, and draws of each chain.
CHAINS, BEFORE, BETWEEN, DRAWS = 200, 6000, 1500, 8
# A base parameter is the data's own where prior and cones make it narrower by less than this.
ALONE = 0.03


def main() -> None:
    rows = []
    for name in sys.argv[1:] or ROBOTS:
        with TemporaryDirectory() as folder:
            done = demonstrate(load_robot(name), Path(folder))
        rows.append(study(name, done.identification.model, done.truth))
    note = (
        "p-values by Kolmogorov and Smirnov, one for each parameter that varies. Spread: median "
        "and range, over base parameters that neither prior nor cones make narrower, of the width "
        "that holds 95 % of 10,000 models over that of the interval."
    )
    leave(HEAD, rows, note)


def study(name: str, model: IdentifiedModel, truth: np.ndarray) -> tuple[object, ...]:
    model.sample(1)
    start = time.process_time()
    thousand = model.sample(1000)
    seconds = time.process_time() - start
    many = model.sample(10_000, seed=1)
    poor = sum(least_margin(model.layout, p)[1] <= 0 for p in many.p)
    chances = agreement(model, many.p)
    ratios = spreads(model, many.p)
    return (
        name,
        int(np.sum(many.p.std(axis=0) > 0)),
        f"{seconds:.1f}",
        f"{thousand.ess.min():.0f}",
        f"{thousand.rhat.max():.3f}",
        f"{poor} of {len(many)}",
        f"{chances.min():.2g} of {len(chances)}",
        f"{np.median(ratios):.3f} ({ratios.min():.3f} – {ratios.max():.3f}), {len(ratios)}",
        f"{coverage(model, truth):.1%}",
    )


def agreement(model: IdentifiedModel, p: np.ndarray) -> np.ndarray:
    """p-values of all parameters against the other sampler."""
    expected = hit_and_run(model, normal(model), p[:2000], np.random.default_rng(0))
    varies = p.std(axis=0) > 0
    some = p[np.random.default_rng(1).choice(len(p), len(expected), replace=False)]
    pairs = zip(some[:, varies].T, expected[:, varies].T, strict=True)
    return np.array([stats.ks_2samp(a, b).pvalue for a, b in pairs])


def hit_and_run(
    model: IdentifiedModel, plain: Normal, drawn: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draws of p: along a random line through the cones, exactly from the normal distribution.

    Lines may have directions of any distribution that does not change; with the covariance of drawn
    models they are short across thin layers and long along them. All chains begin at one of these.
    Where a line leaves a cone follows from eigenvalues: M + t D ≻ 0 while 1 + t λ > 0 for all
    eigenvalues λ of L⁻¹ D L⁻ᵀ, M = L Lᵀ.
    """
    n = plain.spread.shape[1]
    shape = np.linalg.cholesky(np.cov(coordinates(plain, drawn).T))
    y = np.repeat(coordinates(plain, drawn[:1]), CHAINS, axis=0)
    kept = []
    for step in range(BEFORE + BETWEEN * DRAWS):
        along = rng.standard_normal((CHAINS, n)) @ shape.T
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        p, d = plain.middle + y @ plain.spread.T, along @ plain.spread.T
        slopes = eigenvalues(model, p, d)
        with np.errstate(divide="ignore"):
            high = np.where(slopes < 0, -1.0 / slopes, np.inf).min(axis=1)
            low = np.where(slopes > 0, -1.0 / slopes, -np.inf).max(axis=1)
        middle = -np.sum(y * along, axis=1)
        t = truncated(middle, low, high, rng)
        y += t[:, None] * along
        if step >= BEFORE and (step - BEFORE) % BETWEEN == BETWEEN - 1:
            kept.append(plain.middle + y @ plain.spread.T)
    return np.vstack(kept)


def coordinates(plain: Normal, p: np.ndarray) -> np.ndarray:
    """y of some p = middle + spread·y."""
    size = np.linalg.norm(plain.spread, axis=1)
    varies = size > 0
    off = ((p - plain.middle)[:, varies] / size[varies]).T
    return np.linalg.lstsq(plain.spread[varies] / size[varies, None], off, rcond=None)[0].T


def eigenvalues(model: IdentifiedModel, p: np.ndarray, d: np.ndarray) -> np.ndarray:
    """λ of all bodies and coefficients, a row a chain."""
    first, found = 10 * len(model.layout.bodies), []
    for b in range(len(model.layout.bodies)):
        part = slice(10 * b, 10 * b + 10)
        if np.any(d[:, part]):
            L = inv(np.linalg.cholesky(matrices(p[:, part])), assume_a="lower triangular")
            found.append(np.linalg.eigvalsh(L @ matrices(d[:, part]) @ np.swapaxes(L, 1, 2)))
    return np.hstack([*found, d[:, first:] / p[:, first:]])


def truncated(
    middle: np.ndarray, low: np.ndarray, high: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """N(middle, 1) between low and high; a hair from the ends, where rounding is at home."""
    flip = (low + high > 2 * middle) & np.isfinite(low)  # the tail that has digits
    a = np.where(flip, -(high - middle), low - middle)
    b = np.where(flip, middle - low, high - middle)
    u = rng.uniform(1e-9, 1 - 1e-9, len(middle))
    below, above = ndtr(a), ndtr(b)
    t = ndtri(below + u * (above - below))
    t = np.clip(np.where(flip, -t, t) + middle, low, high)
    inner = 1e-9 * np.where(np.isfinite(high - low), high - low, 1.0)
    return np.clip(t, low + inner, high - inner)


def spreads(model: IdentifiedModel, p: np.ndarray) -> np.ndarray:
    """Width of 95 % of models over that of the interval, of base parameters that are the data's."""
    record = model.posterior
    assert record is not None
    plain = normal(model)
    ratios = []
    K, root = record.combination(model.layout.names), record.root
    for k, base in enumerate(model.base_parameters):
        by_data = np.linalg.norm(root[k])
        with_prior = np.linalg.norm(K[k] @ plain.spread)
        low, high = np.quantile(p @ K[k], [0.025, 0.975])
        if with_prior > (1 - ALONE) * by_data and clear(plain, K[k], p):
            ratios.append((high - low) / (base.high - base.low))
    return np.array(ratios)


def clear(plain: Normal, c: np.ndarray, p: np.ndarray) -> bool:
    """Whether consistency moves a combination by less than a tenth of its deviation."""
    moved = abs(float(c @ (p.mean(axis=0) - plain.middle)))
    return moved < 0.1 * float(np.linalg.norm(c @ plain.spread))


def coverage(model: IdentifiedModel, truth: np.ndarray) -> float:
    """Share of the torques of ten other motions, with noise as large as the fit found, that lie
    within 95 % of what models predict with such noise."""
    known, rng, held = load(model), np.random.default_rng(5), []
    drawn = model.sample(500, seed=2).p
    for _ in range(10):
        _, q, qd, qdd = along(known.dynamics.kinematics, rng, 100)
        tau = known.dynamics.inverse_dynamics(q, qd, qdd, truth)
        level = model.fit.noise_level * np.abs(tau).max(axis=0)
        predicted = np.array([known.dynamics.inverse_dynamics(q, qd, qdd, p) for p in drawn])
        predicted += level * rng.standard_normal(predicted.shape)
        low, high = np.quantile(predicted, [0.025, 0.975], axis=0)
        measured = tau + level * rng.standard_normal(tau.shape)
        held.append(np.mean((measured > low) & (measured < high)))
    return float(np.mean(held))


if __name__ == "__main__":
    main()
