"""Whether chains have forgotten where they began, and how many independent draws theirs are worth.

R̂ and effective sample size after Vehtari, Gelman, Simpson, Carpenter and Bürkner (2021): chains are
split in halves and values replaced by normal scores of their ranks. R̂ compares halves with all; so
that it sees differences of spread too, the larger one of values and of their distances from the
median is taken.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import rankdata

# Draws, chains and quantities.
Draws = Float[np.ndarray, "draws chains quantities"]
Each = Float[np.ndarray, " quantities"]
Halves = Float[np.ndarray, "length halves quantities"]


def rhat(draws: Draws) -> Each:
    """The factor by which spread might still grow: 1 where chains agree."""
    folded = np.abs(draws - np.median(draws, axis=(0, 1)))
    return np.maximum(_rhat(_scores(_split(draws))), _rhat(_scores(_split(folded))))


def effective_size(draws: Draws) -> Each:
    """How many independent draws tell as much of the middle of the distribution."""
    z = _scores(_split(draws))
    length, chains, _ = z.shape
    centred = z - z.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(centred, n=2 * length, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, axis=0)[:length].mean(axis=1) / length
    within = covariance[0] * length / (length - 1)
    total = covariance[0] + z.mean(axis=0).var(axis=0, ddof=1)
    correlation = 1.0 - (within - covariance) / total
    correlation[0] = 1.0
    # Geyer: sums of neighbours are positive and fall, as far as noise lets one see.
    pairs = correlation[: length // 2 * 2].reshape(-1, 2, z.shape[2]).sum(axis=1)
    positive = np.logical_and.accumulate(pairs > 0, axis=0)
    pairs = np.minimum.accumulate(np.where(positive, pairs, 0.0), axis=0)
    time = np.maximum(2 * pairs.sum(axis=0) - 1.0, 1.0 / np.log10(max(length * chains, 10)))
    return length * chains / time


def _rhat(z: Halves) -> Each:
    length = len(z)
    within, between = z.var(axis=0, ddof=1).mean(axis=0), z.mean(axis=0).var(axis=0, ddof=1)
    return np.sqrt((length - 1) / length + between / within)


def _split(draws: Draws) -> Halves:
    half = len(draws) // 2
    return np.concatenate([draws[:half], draws[-half:]], axis=1)


def _scores(draws: Halves) -> Halves:
    count = draws.shape[0] * draws.shape[1]
    ranks = rankdata(draws.reshape(count, -1), axis=0)
    return ndtri((ranks - 0.375) / (count + 0.25)).reshape(draws.shape)
