"""The denoiser's U-Net on N vehicles: maps are (C, N, L), channels first, and a convolution is one product.

The same function as ``models.denoiser``, equal up to rounding.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from advdiff_sumo.diffusion.compiled.kernel import Array, kernel, product, sums, total
from advdiff_sumo.diffusion.compiled.smooth import logistic
from advdiff_sumo.models.model_options import GROUPS

_EPS = 1e-5


class BlockWeights(NamedTuple):
    """Weights of a residual block: (C', 3 C) tap by tap, and (C',).

    Attributes:
        first, first_bias: of the first convolution.
        second, second_bias: of the second, (C', 3 C'); behind it what the way past both reads of the block's input,
            (C', C), or nothing where it is the input itself.
    """

    first: Array
    first_bias: Array
    second: Array
    second_bias: Array


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
def spread(x: Array, less: Any) -> Any:
    """Return the sum of the squares of *x* (L,), each number *less* as much."""
    out = x.dtype.type(0.0)
    for i in range(len(x)):
        out += (x[i] - less) * (x[i] - less)
    return out


@kernel
def normalise(x: Array, begin: int, end: int, n: int) -> tuple[Any, Any]:
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
        row = out[c].reshape(vehicles * length)
        for i in range(len(row)):
            row[i] = bias[c]
    return out


@kernel
def add(x: Array, out: Array) -> None:
    """Add *x* (C, N, L) to *out* (C, N, L)."""
    wide = x.shape[1] * x.shape[2]
    for c in range(len(x)):
        row, to = x[c].reshape(wide), out[c].reshape(wide)
        for i in range(wide):
            to[i] += row[i]


@kernel
def copy(x: Array, out: Array, at: int) -> None:
    """Set the channels of *out* (C', N, L) from *at* on to those of *x* (C, N, L)."""
    wide = x.shape[1] * x.shape[2]
    for c in range(len(x)):
        row, to = x[c].reshape(wide), out[at + c].reshape(wide)
        for i in range(wide):
            to[i] = row[i]


@kernel
def residual(w: BlockWeights, x: Array, scale: Array, shift: Array, at: int) -> Array:
    """Return (C', N, L) of *x* (C, N, L); *scale*, *shift* and *at* as in :func:`activate`."""
    _, vehicles, length = x.shape
    y = x
    # one call of each kernel for both: what is compiled twice takes twice as long to compile
    for second in range(2):
        weight, bias = (w.second, w.second_bias) if second else (w.first, w.first_bias)
        columns = np.empty((weight.shape[1], vehicles, length), x.dtype)
        activate(y, scale, shift, at, columns)
        at += len(y)
        if weight.shape[1] > 3 * len(y):
            copy(x, columns, 3 * len(y))
        y = biased(bias, vehicles, length)
        convolve(weight, columns, y)
    if w.second.shape[1] == 3 * len(y):
        add(x, y)
    return y


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
    copy(skip, out, channels)
    return out


@kernel
def unet(w: UNetWeights, blocks: tuple[BlockWeights, ...], y: Array, scale: Array, shift: Array) -> Array:
    """Return (C, N, L) of the maps *y* (C', N, L) after the first convolution.

    The norms' channels lie in *scale* and *shift* one after the other, those of the last norm at the end.
    """
    at, first, second = 0, y, y
    for number in range(len(blocks)):
        if number in (1, 2):
            y = halved(y)
        elif number in (4, 5):
            y = doubled(y, second if number == 4 else first)
        channels = len(y)
        y = residual(blocks[number], y, scale, shift, at)
        at += channels + len(y)
        if number == 0:
            first = y
        elif number == 1:
            second = y
    columns = np.empty((3 * len(y), y.shape[1], y.shape[2]), y.dtype)
    activate(y, scale, shift, at, columns)
    out = biased(w.out_bias, y.shape[1], y.shape[2])
    convolve(w.out, columns, out)
    return out


@kernel
def turn(x: Array, out: Array) -> None:
    """Set *out* (M, N, L) to *x* (N, M, L)."""
    for n in range(x.shape[0]):
        for c in range(x.shape[1]):
            row, to = x[n, c], out[c, n]
            for i in range(len(row)):
                to[i] = row[i]


@kernel
def predict(
    w: UNetWeights,
    blocks: tuple[BlockWeights, ...],
    x: Array,
    about: Array,
    scale: Array,
    shift: Array,
    span: int,
    noise: Array,
) -> None:
    """Set *noise* (M, C, L) to that in *x* (M, C, L), *span* vehicles at a time.

    Args:
        w: weights.
        blocks: of the blocks, in their order.
        x: noisy samples.
        about: (M, C', L) what the condition and the bias add to the first convolution.
        scale: (M, ΣC) of all norms.
        shift: (M, ΣC) of all norms.
        span: vehicles that the processor's caches hold at once.
        noise: to be written.
    """
    vehicles, channels, length = x.shape
    for begin in range(0, vehicles, span):
        end = min(begin + span, vehicles)
        columns = np.empty((3 * channels, end - begin, length), x.dtype)
        y = np.empty((about.shape[1], end - begin, length), x.dtype)
        turn(x[begin:end], columns[channels : 2 * channels])
        turn(about[begin:end], y)
        for c in range(channels):
            beside(columns, channels, c)
        convolve(w.into, columns, y)
        turn(unet(w, blocks, y, scale[begin:end], shift[begin:end]), noise[begin:end])
