"""Convolution of many channels with few filters, as matrix products."""

import numpy as np
from jaxtyping import Float

# Outputs of a filter that one row of a matrix product gives, and numbers that it takes in at once:
# few enough to stay in the cache.
_OUTPUTS, _CHUNK = 16, 1 << 17
# Outputs that are so many samples apart are few.
_SPARSE = 8


def apply(
    taps: Float[np.ndarray, " taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int = 1,
) -> Float[np.ndarray, "channels kept"]:
    """Convolve each channel where the filter fits entirely; keep every `decimation`-th sample."""
    return convolve(taps[None], x, decimation)[0]


def convolve(
    taps: Float[np.ndarray, "filters taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int = 1,
) -> Float[np.ndarray, "filters channels kept"]:
    """Convolve each channel with several filters of equal length, as `apply` does with one.

    Some neighbouring outputs of all filters are one banded matrix times the samples under them, so
    nearly all work is a matrix product, an order of magnitude faster than a loop over taps. Where
    few outputs are kept, samples are cut into pieces as long as these are apart instead.
    """
    filters, length = taps.shape
    if length == 1:
        return taps[:, :, None] * x[:, ::decimation]
    if decimation >= _SPARSE:
        return _sparse(taps, x, decimation)
    channels, samples = x.shape
    kept = max(0, -(-(samples - length + 1) // decimation))
    if not channels:
        return np.zeros((filters, 0, kept))
    span = (_OUTPUTS - 1) * decimation + length
    band = _band(taps, decimation, span)
    step = _OUTPUTS * decimation
    blocks = -(-kept // _OUTPUTS)
    padded = np.zeros((channels, span))  # the samples under the last block, as far as there are
    end = x[:, (blocks - 1) * step :] if blocks else padded[:, :0]
    padded[:, : min(end.shape[1], span)] = end[:, :span]
    out = np.empty((filters, channels, blocks * _OUTPUTS))

    def fill(start: int, under: Float[np.ndarray, "channels blocks span"]) -> None:
        product = np.ascontiguousarray(under).reshape(-1, span) @ band
        shaped = product.reshape(channels, -1, filters, _OUTPUTS).transpose(2, 0, 1, 3)
        width = under.shape[1] * _OUTPUTS
        out[:, :, start * _OUTPUTS :][:, :, :width] = shaped.reshape(filters, channels, width)

    if blocks > 1:
        under = np.lib.stride_tricks.sliding_window_view(x, span, axis=1)[:, ::step]
        at_once = max(1, _CHUNK // (channels * span))
        for start in range(0, blocks - 1, at_once):
            fill(start, under[:, start : min(start + at_once, blocks - 1)])
    if blocks:
        fill(blocks - 1, padded[:, None])
    return out[:, :, :kept]


def _band(
    taps: Float[np.ndarray, "filters taps"], decimation: int, span: int
) -> Float[np.ndarray, "span outputs"]:
    """The matrix of a block: column k of a filter holds its taps, reversed, k·decimation down."""
    filters, length = taps.shape
    band = np.zeros((span, filters, _OUTPUTS))
    column = np.arange(_OUTPUTS)
    band[column * decimation + np.arange(length)[:, None], :, column] = taps[:, ::-1].T[:, None]
    return band.reshape(span, -1)


def _sparse(
    taps: Float[np.ndarray, "filters taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int,
) -> Float[np.ndarray, "filters channels kept"]:
    """y_k = Σ_j h_jᵀ x_{k+j}, with x_m the m-th piece of `decimation` samples, h_j of the taps."""
    filters, length = taps.shape
    channels, samples = x.shape
    kept, pieces = max(0, -(-(samples - length + 1) // decimation)), -(-length // decimation)
    h = np.zeros((filters, pieces * decimation))
    h[:, :length] = taps[:, ::-1]
    h = h.reshape(filters * pieces, decimation)
    out = np.zeros((filters, channels, kept))
    if not kept:
        return out
    count = kept + pieces - 1
    whole = min(count, samples // decimation)
    products = np.empty((channels, len(h), count))
    cut = x[:, : whole * decimation].reshape(channels, whole, decimation)
    np.matmul(h, cut.swapaxes(1, 2), out=products[:, :, :whole])
    if whole < count:  # of the last piece the filter takes in a part
        last = np.zeros((channels, decimation))
        last[:, : samples - whole * decimation] = x[:, whole * decimation : count * decimation]
        products[:, :, whole] = last @ h.T
    for k in range(filters):
        for j in range(pieces):
            out[k] += products[:, k * pieces + j, j : j + kept]
    return out
