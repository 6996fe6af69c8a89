"""Interaction layers with their gradient by hand: G receivers of one scene attend to its A agents.

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
    largest,
    place,
    product,
    relu,
    total,
)
from advdiff_sumo.diffusion.compiled.records import Activations, GraphWeights
from advdiff_sumo.diffusion.compiled.smooth import exponential


@kernel
def soften(share: Array) -> None:
    """Turn scores *share* (A,) into their softmax."""
    most = largest(share)
    for a in range(len(share)):
        share[a] = exponential(share[a] - most)
    every = total(share)
    for a in range(len(share)):
        share[a] /= every


@kernel
def gather(share: Array, message: Array, begin: int, out: Array) -> None:
    """Set *out* (N,) to the mean of columns *begin* … of *message* (A, M), weighed by *share* (A,)."""
    end, even = begin + len(out), len(share) - len(share) % 4
    for m in range(len(out)):
        out[m] = share.dtype.type(0.0)
    for a in range(0, even, 4):
        p0, p1, p2, p3 = share[a], share[a + 1], share[a + 2], share[a + 3]
        r0, r1 = message[a][begin:end], message[a + 1][begin:end]
        r2, r3 = message[a + 2][begin:end], message[a + 3][begin:end]
        for m in range(len(out)):
            out[m] += (p0 * r0[m] + p1 * r1[m]) + (p2 * r2[m] + p3 * r3[m])
    for a in range(even, len(share)):
        p0, r0 = share[a], message[a][begin:end]
        for m in range(len(out)):
            out[m] += p0 * r0[m]


@kernel
def attend(message: Array, score: Array, attention_bias: Array, weight: Array, gathered: Array) -> None:
    """Set one receiver's attention *weight* (H, A) to its *message* (A, M) and what it gathers (M,) by that.

    Args:
        message: (A, M) after the ReLU.
        score: (H, M) weights of the scores.
        attention_bias: (A,) added to the scores: very negative where nobody is.
        weight: (H, A) to be written.
        gathered: (M,) to be written.
    """
    heads, senders = weight.shape
    span = len(gathered) // heads
    for head in range(heads):
        share, line = weight[head], score[head]
        for a in range(senders):
            share[a] = dot(message[a], line) + attention_bias[a]
        soften(share)
        gather(share, message, head * span, gathered[head * span : head * span + span])


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
def graph_attention(
    w: GraphWeights,
    layer: int,
    node: Array,
    ends: Array,
    sent: Array,
    attention_bias: Array,
    activations: Activations,
) -> Array:
    """Return new embeddings (G, D).

    Args:
        w: weights of all layers.
        layer: which one.
        node: (G, D) embeddings of the receivers.
        ends: (G, 2 M) what they add to messages; the first half is read.
        sent: (A, M) what the senders add.
        attention_bias: (A,) added to the scores.
        activations: to be written; its messages hold what relative poses add to them.
    """
    receivers, senders, wide = activations.message.shape
    zero = node.dtype.type(0.0)
    gathered = np.empty((receivers, wide), node.dtype)
    for g in range(receivers):
        own = ends[g]
        for a in range(senders):
            row, from_sender = activations.message[g, a], sent[a]
            for m in range(wide):
                both = row[m] + own[m] + from_sender[m]
                row[m] = both if both > zero else zero
        attend(activations.message[g], w.score[layer], attention_bias, activations.weight[g], gathered[g])
    affine(gathered, w.out[layer], w.out_bias[layer], activations.normal)
    standard(activations.normal, node, w.eps[layer], activations.deviation)
    new = np.empty(node.shape, node.dtype)
    for g in range(receivers):
        row = activations.normal[g]
        for d in range(len(row)):
            new[g, d] = row[d] * w.scale[layer, d] + w.shift[layer, d]
    affine(new, w.first[layer], w.first_bias[layer], activations.hidden)
    relu(activations.hidden)
    for g in range(receivers):
        for d in range(len(new[g])):
            new[g, d] += w.second_bias[layer, d]
    product(activations.hidden, w.second[layer], new)
    return new


@kernel
def graph_attention_back(
    w: GraphWeights, layer: int, grad: Array, activations: Activations, sender: Array
) -> tuple[Array, Array]:
    """Return the gradients of embeddings as they go past the messages (G, D), and of what receivers add (G, M).

    Args:
        w: weights of all layers.
        layer: which one.
        grad: (G, D) gradient of the new embeddings.
        activations: of the way forward.
        sender: (A, M) gradient of what the senders add; is added to.
    """
    hidden, past = np.empty(activations.hidden.shape, grad.dtype), np.empty(grad.shape, grad.dtype)
    wide = (len(grad), sender.shape[1])
    gathered, receiver = np.empty(wide, grad.dtype), np.empty(wide, grad.dtype)
    clear(hidden)
    clear(gathered)
    clear(receiver)
    product(grad, w.back_second[layer], hidden)
    keep(hidden, activations.hidden)
    place(grad, 0, past, 0, grad.shape[1])
    product(hidden, w.back_first[layer], past)
    for g in range(len(past)):
        row, normal = past[g], activations.normal[g]
        mean = along = 0.0
        for d in range(len(row)):
            row[d] *= w.scale[layer, d]
            mean += row[d]
            along += row[d] * normal[d]
        mean, along = mean / len(row), along / len(row)
        for d in range(len(row)):
            row[d] = activations.deviation[g] * (row[d] - mean - normal[d] * along)
    product(past, w.back_out[layer], gathered)
    for g in range(len(past)):
        attend_back(
            gathered[g], w.score[layer], activations.message[g], activations.weight[g], receiver[g], sender
        )
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
    slope = np.empty((senders, heads), weight.dtype)
    for head in range(heads):
        begin, end = head * span, (head + 1) * span
        mean = zero
        for a in range(senders):
            slope[a, head] = dot(gathered[begin:end], message[a][begin:end])
            mean += weight[head, a] * slope[a, head]
        for a in range(senders):
            slope[a, head] = weight[head, a] * (slope[a, head] - mean)
    rows = np.zeros(message.shape, message.dtype)
    product(slope, score, rows)
    for a in range(senders):
        row, to, sent = rows[a], sender[a], message[a]
        for head in range(heads):
            begin, end, share = head * span, (head + 1) * span, weight[head, a]
            part, by = row[begin:end], gathered[begin:end]
            for m in range(span):
                part[m] += share * by[m]
        for m in range(len(row)):
            row[m] = row[m] if sent[m] > zero else zero
        for m in range(len(row)):
            receiver[m] += row[m]
        for m in range(len(row)):
            to[m] += row[m]
