"""Models drawn from a posterior, refused where chains have not converged; intervals of parameters
from them, which respect consistency; limbs that differ within a tolerance.

Convergence is judged by R̂ and effective sample size after Vehtari, Gelman, Simpson, Carpenter and
Bürkner (2021): chains are split in halves and values replaced by normal scores of their ranks. R̂
compares halves with all; the larger R̂ of values and of their distances from the median is taken, so
that differences of spread count too.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import rankdata
from threadpoolctl import threadpool_limits

from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DeltaidError, DescriptionError, IdentificationError, within
from deltaid.estimation.posterior_density import Chains, density
from deltaid.estimation.reduction import connected
from deltaid.model.model import Model, load
from deltaid.model.options import SAMPLES_LIMITS, TOLERANCE_LIMITS
from deltaid.model.record import IdentifiedModel
from deltaid.model.samples import Samples
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import inertia_parameters, pseudo_inertia

# Number of chains, least draws of each, rounds before the first and between draws.
_CHAINS, _DRAWS, _BEFORE, _BETWEEN = 256, 32, 10, 3
# Target R̂ and share of effective draws; number of times that rounds are doubled to reach them.
_AIMED, _LONGER = (1.04, 0.4), 4
# Limits of both beyond which draws are refused.
_LARGEST_RHAT, _LEAST_SHARE = 1.05, 0.1
# Number of models for intervals, whose ends then err by some 3 % of their width.
_MODELS = 8000
# Quantiles of a 95 % interval.
_ENDS = (0.025, 0.975)

Draws = Float[np.ndarray, "draws chains quantities"]
Halves = Float[np.ndarray, "length halves quantities"]
Each = Float[np.ndarray, " quantities"]
Models = Float[np.ndarray, "samples _"]
OfParameters = Float[np.ndarray, " parameters"]
Walked = tuple[Float[np.ndarray, "draws chains n"], OfParameters, OfParameters]


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def draw(model: Model, n: int, seed: int = 0, limb_tolerance: float = 0.0) -> Samples:
    """Consistent models drawn from data, prior and cones together.

    Args:
        n: how many.
        seed: the same one gives the same models.
        limb_tolerance: relative standard deviation of masses and second moments from limb to limb;
            0 for limbs that are the same.

    Raises:
        DescriptionError: the model is a robot at its prior, or of a version that kept no posterior.
        IdentificationError: the chains do not agree, so their draws are not of the posterior.
    """
    within("n", n, SAMPLES_LIMITS)
    within("limb_tolerance", limb_tolerance, TOLERANCE_LIMITS)
    if seed < 0:
        raise DeltaidError(f"must not be negative, and is {seed}", where="seed")
    if model.identified is None:
        raise DescriptionError(
            "is a robot with its prior, and models are drawn from what a recording has determined",
            where=model.source or model.robot.name,
            cure="identify it first: `deltaid identify ROBOT LOG… -o MODEL`",
        )
    robot = with_own_limbs(model.robot) if limb_tolerance else model.robot
    posterior, rng = density(model.identified, model.source), np.random.default_rng(seed)
    chains = Chains(posterior, _CHAINS, rng)
    chains.walk(_BEFORE)
    chains.turn()
    chains.walk(2 * _BEFORE)
    y, size, factor = _settled(chains, max(_DRAWS, -(-n // _CHAINS)), model)
    chosen = rng.permutation(len(y) * y.shape[1])[:n]
    p = posterior.parameters(y.reshape(-1, y.shape[2])[chosen])
    size = np.minimum(size * n / (len(y) * y.shape[1]), n)
    if limb_tolerance:
        p, origin = scattered(model.robot, robot, p, limb_tolerance, rng)
        size, factor = size[origin], factor[origin]
    return Samples(model, robot, p, size, factor, seed, limb_tolerance)


def _settled(chains: Chains, draws: int, model: Model) -> Walked:
    """Draws of converged chains, their effective number and R̂."""
    y, size, factor = _walked(chains, draws, _BETWEEN)
    for k in range(1, _LONGER + 1):
        if factor.max() < _AIMED[0] and size.min() > _AIMED[1] * y[..., 0].size:
            break
        y, size, factor = _walked(chains, draws, _BETWEEN << k)
    share = float(size.min()) / y[..., 0].size
    if factor.max() > _LARGEST_RHAT or share < _LEAST_SHARE:
        names = chains.density.reduction.layout.names
        raise IdentificationError(
            f"the chains that draw models do not agree: R̂ is {factor.max():.3f} for "
            f"{names[int(factor.argmax())]} (at most {_LARGEST_RHAT:g}), and of "
            f"{names[int(size.argmin())]} only {share:.0%} of the draws count (at least "
            f"{_LEAST_SHARE:.0%})",
            where=model.source,
            cure="identify again with a motion that shows more (`deltaid excite`), a smaller "
            "--prior-spread, or a description that frees fewer entries",
        )
    return y, size, factor


def _walked(chains: Chains, draws: int, between: int) -> Walked:
    """Draws of all chains, with rounds before each; effective number of draws and R̂ of every
    parameter, all draws and 1 for fixed ones."""
    walked = []
    for _ in range(draws):
        chains.walk(between)
        walked.append(chains.y)
    y = np.array(walked)
    p = chains.density.parameters(y.reshape(-1, y.shape[2])).reshape(*y.shape[:2], -1)
    varies = np.any(chains.density.reduction.A != 0, axis=1)
    size, factor = np.full(p.shape[2], float(y[..., 0].size)), np.ones(p.shape[2])
    size[varies], factor[varies] = effective_size(p[:, :, varies]), rhat(p[:, :, varies])
    return y, size, factor


def with_posterior_intervals(model: IdentifiedModel) -> IdentifiedModel:
    """The model with intervals and deviations of its parameters by drawn models.

    Fixed parameters, labels, base parameters, loads and friction curves are unchanged.

    Raises:
        IdentificationError: draws could not be trusted.
    """
    p = draw(load(model), _MODELS).p
    low, high = np.quantile(p, _ENDS, axis=0)
    ends = zip(model.parameters, low.tolist(), high.tolist(), p.std(axis=0).tolist(), strict=True)
    parameters = tuple(
        parameter
        if low == high
        else parameter.changed(
            low=min(low, parameter.value), high=max(high, parameter.value), std=deviation
        )
        for parameter, low, high, deviation in ends
    )
    settings = model.settings.changed(intervals="posterior")
    return model.changed(parameters=parameters, settings=settings)


def rhat(draws: Draws) -> Each:
    """The factor by which spread might still grow: 1 where chains agree."""
    folded = np.abs(draws - np.median(draws, axis=(0, 1)))
    return np.maximum(_spread(_scores(draws)), _spread(_scores(folded)))


def effective_size(draws: Draws) -> Each:
    """Number of independent draws that determine the distribution's centre as well."""
    z = _scores(draws)
    length, chains, _ = z.shape
    spectrum = np.abs(np.fft.rfft(z - z.mean(axis=0), n=2 * length, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, axis=0)[:length].mean(axis=1) / length
    within = covariance[0] * length / (length - 1)
    total = covariance[0] + z.mean(axis=0).var(axis=0, ddof=1)
    correlation = 1.0 - (within - covariance) / total
    correlation[0] = 1.0
    # Geyer: sums of neighbouring autocorrelations are positive and decrease, but for noise.
    pairs = correlation[: length // 2 * 2].reshape(-1, 2, z.shape[2]).sum(axis=1)
    positive = np.logical_and.accumulate(pairs > 0, axis=0)
    pairs = np.minimum.accumulate(np.where(positive, pairs, 0.0), axis=0)
    time = np.maximum(2 * pairs.sum(axis=0) - 1.0, 1.0 / np.log10(max(length * chains, 10)))
    return length * chains / time


def _spread(z: Halves) -> Each:
    """Ratio of the spread of all halves together to that of each."""
    length = len(z)
    within, between = z.var(axis=0, ddof=1).mean(axis=0), z.mean(axis=0).var(axis=0, ddof=1)
    return np.sqrt((length - 1) / length + between / within)


def _scores(draws: Draws) -> Halves:
    """Normal scores of the ranks of all draws, chains split in halves."""
    half = len(draws) // 2
    halves = np.concatenate([draws[:half], draws[-half:]], axis=1)
    count = halves[..., 0].size
    ranks = rankdata(halves.reshape(count, -1), axis=0)
    return ndtri((ranks - 0.375) / (count + 0.25)).reshape(halves.shape)


def with_own_limbs(robot: RobotDescription) -> RobotDescription:
    """The robot with separate bodies in each limb; an error if it has no identical limbs."""
    limbs = robot.limbs
    if limbs is None or not limbs.identical or limbs.count < 2:
        raise DescriptionError(
            "has no limbs that are the same, so there is nothing to scatter",
            where="limb tolerance",
            cure="leave it out (0): bodies of each limb are drawn by themselves already",
        )
    separate = limbs.changed(identical=False)
    bodies, shared = dict(robot.bodies), dict.fromkeys(robot.limb_bodies(0))
    for name in shared:
        body = bodies.pop(name).changed(measured=())
        bodies |= {f"{name}{i + 1}": body for i in range(limbs.count)}
    return robot.changed(limbs=separate, bodies=bodies, measured=(), sensors={})


def scattered(
    robot: RobotDescription,
    separate: RobotDescription,
    p: Models,
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[Models, list[int]]:
    """Limbs that were identified as equal, each with bodies of its own that scatter about these.

    Limb i of n has M̄_i = L W_i Lᵀ where M̄ = L Lᵀ is the body that all share, and

        W_i = n S^-½ Z_i Z_iᵀ S^-½,   S = Σ_j Z_j Z_jᵀ,   Z_i Z_iᵀ Wishart, ν degrees of freedom

    (a matrix-variate Dirichlet distribution). So each body stays consistent, the mean over the
    limbs is M̄ itself, and uᵀM̄_i u, a mass or any second moment, has the relative standard
    deviation √((n − 1) / (n ν/2 + 1)), the tolerance, which sets ν. Rows of M̄ that hang together
    scatter together, also in entries between them that are zero in M̄; between other rows these stay
    zero.

    Args:
        p: of the robot whose limbs are the same.

    Returns:
        Parameters of the robot with own limbs, and which of the shared ones each comes from.
    """
    before, after = parameter_layout(robot), parameter_layout(separate)
    assert robot.limbs is not None
    count, place = robot.limbs.count, {name: i for i, name in enumerate(before.names)}
    origin = [place.get(name, -1) for name in after.names]
    parameters = p[:, origin]
    for name in robot.limb_bodies(0):
        bodies = _scattered(p[:, before.body(name)], count, tolerance, rng)
        for i in range(count):
            part = after.body(f"{name}{i + 1}")
            parameters[:, part] = bodies[:, i]
            origin[part] = range(before.body(name).start, before.body(name).stop)
    return parameters, origin


def _scattered(
    p: Float[np.ndarray, "samples 10"], count: int, tolerance: float, rng: np.random.Generator
) -> Float[np.ndarray, "samples limbs 10"]:
    M = pseudo_inertia(p)
    result = np.repeat(M[:, None], count, axis=1)
    freedom = 2.0 * ((count - 1) / tolerance**2 - 1.0) / count
    for rows in connected(np.any(M != 0, axis=0)):
        L = np.linalg.cholesky(M[:, rows[:, None], rows])
        # Z Zᵀ is Wishart (Bartlett): lower triangles, χ on the diagonal, N(0, 1) below
        Z = np.tril(rng.standard_normal((len(M), count, len(rows), len(rows))), -1)
        for i in range(len(rows)):
            Z[..., i, i] = np.sqrt(rng.chisquare(freedom - i, (len(M), count)))
        W = Z @ Z.mT
        values, V = np.linalg.eigh(W.sum(axis=1))
        H = (L @ (V / np.sqrt(values)[:, None]) @ V.mT)[:, None]
        result[:, :, rows[:, None], rows] = count * H @ W @ H.mT
    return inertia_parameters(result)
