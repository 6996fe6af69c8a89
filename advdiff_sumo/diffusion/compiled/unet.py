"""The denoiser's U-Net on N vehicles: maps are (C, N, L), channels first, and a convolution is one product.

The same function as ``models.denoiser``, equal up to rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from advdiff_sumo.diffusion.compiled.kernel import Array, kernel, product, sums, total
from advdiff_sumo.diffusion.compiled.smooth import logistic
from advdiff_sumo.models.options import GROUPS

_EPS = 1e-5


class BlockWeights(NamedTuple):
    """Weights of a residual block: (C', 3 C) tap by tap, and (C',).

    Attributes:
        first, first_bias: of the first convolution.
        second, second_bias: of the second.
        past: (C', C) of the way past both, or (0, 0) where that is nothing but the input.
    """

    first: Array
    first_bias: Array
    second: Array
    second_bias: Array
    past: Array


class UNetWeights(NamedTuple):
    """Weights of the U-Net but for the blocks'.

    Attributes:
        into: (C', 3 C) of the noisy sample in the first convolution.
        out, out_bias: (C, 3 C') and (C,) of the last.
    """

    into: Array
    out: Array
    out_bias: Array


@sums
def spread(x: Array, less: float) -> float:
    """Return the sum of the squares of *x* (L,), each number *less* as much."""
    out = x.dtype.type(0.0)
    for i in range(len(x)):
        out += (x[i] - less) * (x[i] - less)
    return out


@kernel
def normalise(x: Array, begin: int, end: int, n: int) -> tuple[float, float]:
    """Return the mean and 1 over the deviation of channels *begin* … *end* of vehicle *n* in *x* (C, N, L)."""
    count = (end - begin) * x.shape[2]
    mean = square = 0.0
    for c in range(begin, end):
        mean += total(x[c, n])
    middle = x.dtype.type(mean / count)
    for c in range(begin, end):
        square += spread(x[c, n], middle)
    return middle, x.dtype.type(1.0 / math.sqrt(square / count + _EPS))


@kernel
def beside(columns: Array, channels: int, c: int) -> None:
    """Set what channel *c* adds to *columns* (3 C, N, L) as a neighbour; its own part is there."""
    vehicles, length = columns.shape[1:]
    wide = vehicles * length
    left, right = columns[c].reshape(wide), columns[2 * channels + c].reshape(wide)
    own = columns[channels + c].reshape(wide)
    for i in range(1, wide):
        left[i] = own[i - 1]
    for i in range(1, wide):
        right[i - 1] = own[i]
    for n in range(vehicles):
        left[n * length] = right[n * length + length - 1] = columns.dtype.type(0.0)


@kernel
def activate(x: Array, scale: Array, shift: Array, at: int, columns: Array) -> None:
    """Set *columns* (3 C, N, L) to each place and its neighbours in SiLU(AdaGN(*x*)).

    Args:
        x: (C, N, L).
        scale: (N, ΣC) what normalised channels are multiplied by.
        shift: (N, ΣC) and what is added to them.
        at: the first of them that is this norm's.
        columns: to be written.
    """
    channels, vehicles, length = x.shape
    width = channels // GROUPS
    for begin in range(0, channels, width):
        for n in range(vehicles):
            mean, sharp = normalise(x, begin, begin + width, n)
            for c in range(begin, begin + width):
                slope, row = sharp * scale[n, at + c], x[c, n]
                offset, own = shift[n, at + c] - mean * slope, columns[channels + c, n]
                for i in range(length):
                    own[i] = row[i] * slope + offset
    for c in range(channels):
        line = columns[channels + c].reshape(vehicles * length)
        for i in range(len(line)):
            line[i] *= logistic(line[i])
        beside(columns, channels, c)


@kernel
def convolve(weight: Array, columns: Array, out: Array) -> None:
    """Add to *out* (C', N, L) the product of *weight* (C', K) and *columns* (K, N, L)."""
    wide = out.shape[1] * out.shape[2]
    product(weight, columns.reshape(len(columns), wide), out.reshape(len(out), wide))


@kernel
def biased(bias: Array, vehicles: int, length: int) -> Array:
    """Return *bias* (C,) everywhere, (C, N, L)."""
    out = np.empty((len(bias), vehicles, length), bias.dtype)
    for c in range(len(bias)):
        out[c] = bias[c]
    return out


@kernel
def residual(w: BlockWeights, x: Array, scale: Array, shift: Array, at: int) -> Array:
    """Return (C', N, L) of *x* (C, N, L); *scale*, *shift* and *at* as in :func:`activate`."""
    channels, vehicles, length = x.shape
    columns = np.empty((3 * channels, vehicles, length), x.dtype)
    activate(x, scale, shift, at, columns)
    made = biased(w.first_bias, vehicles, length)
    convolve(w.first, columns, made)
    columns = np.empty((3 * len(made), vehicles, length), x.dtype)
    activate(made, scale, shift, at + channels, columns)
    out = biased(w.second_bias, vehicles, length)
    if len(w.past):
        convolve(w.past, x, out)
    else:
        out += x
    convolve(w.second, columns, out)
    return out


@kernel
def halved(x: Array) -> Array:
    """Return the means of pairs of places, (C, N, L / 2)."""
    channels, vehicles, length = x.shape
    out = np.empty((channels, vehicles, length // 2), x.dtype)
    half = x.dtype.type(0.5)
    for c in range(channels):
        for n in range(vehicles):
            for i in range(length // 2):
                out[c, n, i] = half * (x[c, n, 2 * i] + x[c, n, 2 * i + 1])
    return out


@kernel
def doubled(x: Array, skip: Array) -> Array:
    """Return each place of *x* (C, N, L) twice, and *skip* (C', N, 2 L) behind it."""
    channels, vehicles, length = x.shape
    out = np.empty((channels + len(skip), vehicles, 2 * length), x.dtype)
    for c in range(channels):
        for n in range(vehicles):
            for i in range(length):
                out[c, n, 2 * i] = out[c, n, 2 * i + 1] = x[c, n, i]
    out[channels:] = skip
    return out


@kernel
def unet(w: UNetWeights, blocks: tuple[BlockWeights, ...], y: Array, scale: Array, shift: Array) -> Array:
    """Return (C, N, L) of the maps *y* (C', N, L) after the first convolution.

    The norms' channels lie in *scale* and *shift* one after the other, those of the last norm at the end.
    """
    at = 0
    first = residual(blocks[0], y, scale, shift, at)
    at += len(y) + len(first)
    y = halved(first)
    second = residual(blocks[1], y, scale, shift, at)
    at += len(y) + len(second)
    y = halved(second)
    third = residual(blocks[2], y, scale, shift, at)
    at += len(y) + len(third)
    y = residual(blocks[3], third, scale, shift, at)
    at += len(third) + len(y)
    wide = doubled(y, second)
    y = residual(blocks[4], wide, scale, shift, at)
    at += len(wide) + len(y)
    wide = doubled(y, first)
    y = residual(blocks[5], wide, scale, shift, at)
    at += len(wide) + len(y)
    columns = np.empty((3 * len(y), y.shape[1], y.shape[2]), y.dtype)
    activate(y, scale, shift, at, columns)
    out = biased(w.out_bias, y.shape[1], y.shape[2])
    convolve(w.out, columns, out)
    return out


@kernel
def predict(
    w: UNetWeights,
    blocks: tuple[BlockWeights, ...],
    x: Array,
    about: Array,
    scale: Array,
    shift: Array,
    span: int,
    made: Array,
) -> None:
    """Set *made* (M, C, L) to the noise in *x* (M, C, L), *span* vehicles at a time.

    Args:
        w: weights.
        blocks: of the blocks, in their order.
        x: noisy samples.
        about: (M, C', L) what the condition and the bias add to the first convolution.
        scale: (M, ΣC) of all norms.
        shift: (M, ΣC) of all norms.
        span: vehicles that the processor's caches hold at once.
        made: to be written.
    """
    vehicles, channels, length = x.shape
    for begin in range(0, vehicles, span):
        end = min(begin + span, vehicles)
        columns = np.empty((3 * channels, end - begin, length), x.dtype)
        y = np.empty((about.shape[1], end - begin, length), x.dtype)
        for n in range(begin, end):
            for c in range(channels):
                columns[channels + c, n - begin] = x[n, c]
            for c in range(len(y)):
                y[c, n - begin] = about[n, c]
        for c in range(channels):
            beside(columns, channels, c)
        convolve(w.into, columns, y)
        out = unet(w, blocks, y, scale[begin:end], shift[begin:end])
        for n in range(begin, end):
            for c in range(channels):
                made[n, c] = out[c, n - begin]
