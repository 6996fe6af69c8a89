"""Interaction layers with their gradient by hand: G receivers of one scene hear its A agents.

The same function as ``models.interaction.InteractionLayer``, equal up to rounding.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.diffusion.compiled.kernel import (
    Array,
    affine,
    clear,
    dot,
    keep,
    kernel,
    place,
    product,
    relu,
)
from advdiff_sumo.diffusion.compiled.records import GraphWeights, Heard
from advdiff_sumo.diffusion.compiled.smooth import exponential


@kernel
def attend(message: Array, score: Array, lower: Array, weight: Array, gathered: Array) -> None:
    """Set one receiver's attention *weight* (H, A) to its *message* (A, M) and what it gathers (M,) by that.

    Args:
        message: (A, M) after the ReLU.
        score: (H, M) weights of the scores.
        lower: (A,) added to the scores: very negative where nobody is.
        weight: (H, A) to be written.
        gathered: (M,) to be written.
    """
    heads, senders = weight.shape
    span = len(gathered) // heads
    zero = gathered.dtype.type(0.0)
    for m in range(len(gathered)):
        gathered[m] = zero
    for head in range(heads):
        share = weight[head]
        for a in range(senders):
            share[a] = dot(message[a], score[head]) + lower[a]
        most = share[0]
        for a in range(senders):
            most = max(most, share[a])
        total = zero
        for a in range(senders):
            share[a] = exponential(share[a] - most)
        for a in range(senders):
            total += share[a]
        begin = head * span
        for a in range(senders):
            share[a] /= total
            part, row = share[a], message[a]
            for m in range(begin, begin + span):
                gathered[m] += part * row[m]


@kernel
def standard(x: Array, node: Array, eps: float, deviation: Array) -> None:
    """Add *node* to *x* (G, D), bring its rows to mean 0 and deviation 1; write 1 over their *deviation* (G,)."""
    for g in range(len(x)):
        row = x[g]
        mean = square = 0.0
        for d in range(len(row)):
            row[d] += node[g, d]
            mean += row[d]
        mean /= len(row)
        for d in range(len(row)):
            square += (row[d] - mean) ** 2
        deviation[g] = 1.0 / math.sqrt(square / len(row) + eps)
        for d in range(len(row)):
            row[d] = (row[d] - mean) * deviation[g]


@kernel
def listen(
    w: GraphWeights, layer: int, node: Array, ends: Array, said: Array, lower: Array, heard: Heard
) -> Array:
    """Return new embeddings (G, D).

    Args:
        w: weights of all layers.
        layer: which one.
        node: (G, D) embeddings of the receivers.
        ends: (G, 2 M) what they add to messages; the first half is read.
        said: (A, M) what the senders add.
        lower: (A,) added to the scores.
        heard: to be written; its messages hold what relative poses add to them.
    """
    receivers, senders, wide = heard.message.shape
    zero = node.dtype.type(0.0)
    gathered = np.empty((receivers, wide), node.dtype)
    for g in range(receivers):
        own = ends[g]
        for a in range(senders):
            row, told = heard.message[g, a], said[a]
            for m in range(wide):
                both = row[m] + own[m] + told[m]
                row[m] = both if both > zero else zero
        attend(heard.message[g], w.score[layer], lower, heard.weight[g], gathered[g])
    affine(gathered, w.out[layer], w.out_bias[layer], heard.normal)
    standard(heard.normal, node, w.eps[layer], heard.deviation)
    new = np.empty(node.shape, node.dtype)
    for g in range(receivers):
        row = heard.normal[g]
        for d in range(len(row)):
            new[g, d] = row[d] * w.scale[layer, d] + w.shift[layer, d]
    affine(new, w.first[layer], w.first_bias[layer], heard.hidden)
    relu(heard.hidden)
    for g in range(receivers):
        for d in range(len(new[g])):
            new[g, d] += w.second_bias[layer, d]
    product(heard.hidden, w.second[layer], new)
    return new


@kernel
def listen_back(w: GraphWeights, layer: int, grad: Array, heard: Heard, sender: Array) -> tuple[Array, Array]:
    """Return the gradients of embeddings as they go past the messages (G, D), and of what receivers add (G, M).

    Args:
        w: weights of all layers.
        layer: which one.
        grad: (G, D) gradient of the new embeddings.
        heard: of the way forward.
        sender: (A, M) gradient of what the senders add; is added to.
    """
    hidden, past = np.empty(heard.hidden.shape, grad.dtype), np.empty(grad.shape, grad.dtype)
    wide = (len(grad), sender.shape[1])
    gathered, receiver = np.empty(wide, grad.dtype), np.empty(wide, grad.dtype)
    clear(hidden)
    clear(gathered)
    clear(receiver)
    product(grad, w.back_second[layer], hidden)
    keep(hidden, heard.hidden)
    place(grad, 0, past, 0, grad.shape[1])
    product(hidden, w.back_first[layer], past)
    for g in range(len(past)):
        row, normal = past[g], heard.normal[g]
        mean = along = 0.0
        for d in range(len(row)):
            row[d] *= w.scale[layer, d]
            mean += row[d]
            along += row[d] * normal[d]
        mean, along = mean / len(row), along / len(row)
        for d in range(len(row)):
            row[d] = heard.deviation[g] * (row[d] - mean - normal[d] * along)
    product(past, w.back_out[layer], gathered)
    for g in range(len(past)):
        attend_back(gathered[g], w.score[layer], heard.message[g], heard.weight[g], receiver[g], sender)
    return past, receiver


@kernel
def attend_back(
    gathered: Array, score: Array, message: Array, weight: Array, receiver: Array, sender: Array
) -> None:
    """Add the gradients of one receiver's messages to those of both ends, for the gradient of what it gathers (M,).

    Args:
        gathered: (M,) the gradient.
        score: (H, M) weights of the scores.
        message: (A, M) after the ReLU.
        weight: (H, A) attention.
        receiver: (M,) is added to.
        sender: (A, M) is added to.
    """
    heads, senders = weight.shape
    span = len(gathered) // heads
    zero = gathered.dtype.type(0.0)
    slope = np.empty(weight.shape, weight.dtype)
    for head in range(heads):
        begin, end = head * span, (head + 1) * span
        mean = zero
        for a in range(senders):
            slope[head, a] = dot(gathered[begin:end], message[a, begin:end])
            mean += weight[head, a] * slope[head, a]
        for a in range(senders):
            slope[head, a] = weight[head, a] * (slope[head, a] - mean)
    row = np.empty(len(gathered), gathered.dtype)
    for a in range(senders):
        for head in range(heads):
            share = weight[head, a]
            for m in range(head * span, head * span + span):
                row[m] = share * gathered[m]
        for head in range(heads):
            part, line = slope[head, a], score[head]
            for m in range(len(row)):
                row[m] += part * line[m]
        to, heard = sender[a], message[a]
        for m in range(len(row)):
            by = row[m] if heard[m] > zero else zero
            receiver[m] += by
            to[m] += by
