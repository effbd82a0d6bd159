"""Models drawn from a posterior, or a refusal where the draws could not be trusted."""

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.errors import DeltaidError, DescriptionError, IdentificationError
from deltaid.model.model import Model
from deltaid.model.options import SAMPLES_LIMITS, TOLERANCE_LIMITS
from deltaid.model.samples import Samples
from deltaid.posterior.density import density
from deltaid.posterior.diagnostics import effective_size, rhat
from deltaid.posterior.limbs import scattered, with_own_limbs
from deltaid.posterior.sampler import Chains

# Chains, draws of each at least, rounds before and between draws.
_CHAINS, _DRAWS, _BEFORE, _BETWEEN = 256, 32, 10, 2
# R̂ and share of effective draws that are aimed at, by walking twice as far so many times.
_AIMED, _LONGER = (1.03, 0.5), 4
# Beyond these, draws are refused.
_LARGEST_RHAT, _LEAST_SHARE = 1.05, 0.1

Draws = Float[np.ndarray, "draws chains n"]
Each = Float[np.ndarray, " parameters"]


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
    _within("n", float(n), SAMPLES_LIMITS)
    _within("limb_tolerance", float(limb_tolerance), TOLERANCE_LIMITS)
    if seed < 0:
        raise DeltaidError(f"must not be negative, and is {seed}", where="seed")
    if model.identified is None:
        raise DescriptionError(
            "is a robot with its prior, and models are drawn from what a recording has told",
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


def _settled(chains: Chains, draws: int, model: Model) -> tuple[Draws, Each, Each]:
    """Draws of chains that have forgotten where they began, their effective number and R̂.

    Raises:
        IdentificationError: the chains do not agree after the longest walk.
    """
    y = _walked(chains, draws, _BETWEEN)
    size, factor = _judged(chains, y)
    for k in range(_LONGER):
        if factor.max() < _AIMED[0] and size.min() > _AIMED[1] * y.shape[0] * y.shape[1]:
            return y, size, factor
        y = _walked(chains, draws, _BETWEEN << (k + 1))
        size, factor = _judged(chains, y)
    share = float(size.min()) / (y.shape[0] * y.shape[1])
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


def _walked(chains: Chains, draws: int, between: int) -> Draws:
    """So many draws of all chains, and rounds before each."""
    kept = []
    for _ in range(draws):
        chains.walk(between)
        kept.append(chains.y)
    return np.array(kept)


def _judged(chains: Chains, y: Draws) -> tuple[Each, Each]:
    """Effective number of draws and R̂ of every parameter; all of them and 1 of what is held."""
    p = chains.density.parameters(y.reshape(-1, y.shape[2])).reshape(*y.shape[:2], -1)
    varies = np.any(chains.density.reduction.A != 0, axis=1)
    size, factor = np.full(p.shape[2], float(y.shape[0] * y.shape[1])), np.ones(p.shape[2])
    size[varies], factor[varies] = effective_size(p[:, :, varies]), rhat(p[:, :, varies])
    return size, factor


def _within(name: str, value: float, limits: tuple[float, float]) -> None:
    if not limits[0] <= value <= limits[1]:
        raise DeltaidError(
            f"must lie between {limits[0]:g} and {limits[1]:g}, not {value:g}", where=name
        )
