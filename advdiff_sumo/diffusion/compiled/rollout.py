"""The decoder's roll-out of G vehicles of one scene of A agents, T steps, with the gradient of their latents.

The same function as ``models.decoder``, equal up to rounding.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.arrays import IntArray
from advdiff_sumo.diffusion.compiled.graph_kernel import graph_attention
from advdiff_sumo.diffusion.compiled.kernel import (
    Array,
    affine,
    clear,
    kernel,
    place,
    product,
    relu,
)
from advdiff_sumo.diffusion.compiled.records import (
    Activations,
    EdgeWeights,
    GraphWeights,
    RollWeights,
    Tape,
    Trace,
    activations_at,
    activations_of,
)
from advdiff_sumo.diffusion.compiled.smooth import logistic, tangent
from advdiff_sumo.diffusion.compiled.vehicle_kernel import MOTION, drive, features

_NEAR_PER_M = 0.1
_SOFT_M2 = 1e-6
RELATIVE_POSE = 8
"""Numbers of a relative pose: place, heading and velocity in the receiver's frame, nearness, the receiver's speed."""


@kernel
def edge_features(w: EdgeWeights, motion: Array, rows: IntArray, message: Array) -> None:
    """Set *message* (L, G, A, M) to the embedded poses of agents at *motion* (A, 4) relative to *rows* of them."""
    agents = len(motion)
    cos, sin = np.empty(agents, motion.dtype), np.empty(agents, motion.dtype)
    for a in range(agents):
        cos[a], sin[a] = math.cos(motion[a, 2]), math.sin(motion[a, 2])
    relative = np.empty((agents, RELATIVE_POSE), motion.dtype)
    hidden = np.empty((agents, w.edge_features.shape[1]), motion.dtype)
    embedded = np.empty((agents, w.look.shape[1]), motion.dtype)
    for g in range(len(rows)):
        me = rows[g]
        for a in range(agents):
            x, y = motion[a, 0] - motion[me, 0], motion[a, 1] - motion[me, 1]
            ahead, across = cos[a] * cos[me] + sin[a] * sin[me], sin[a] * cos[me] - cos[a] * sin[me]
            relative[a, 0], relative[a, 1] = x * cos[me] + y * sin[me], y * cos[me] - x * sin[me]
            relative[a, 2], relative[a, 3] = ahead, across
            relative[a, 4], relative[a, 5] = ahead * motion[a, 3], across * motion[a, 3]
            relative[a, 6] = math.exp(-_NEAR_PER_M * math.sqrt(x * x + y * y + _SOFT_M2))
            relative[a, 7] = motion[me, 3]
        affine(relative, w.edge_features, w.edge_bias, hidden)
        relu(hidden)
        affine(hidden, w.look, w.look_bias, embedded)
        relu(embedded)
        for layer in range(len(message)):
            clear(message[layer, g])
            product(embedded, w.edge[layer], message[layer, g])


@kernel
def begin_node(
    weight: Array, cars: Array, motion: Array, from_memory: Array, given: Array, node: Array
) -> None:
    """Set *node* (G, D) to what memory, latent and own motion make of it."""
    width = node.shape[1]
    own = np.empty((len(cars), MOTION), node.dtype)
    for g in range(len(cars)):
        features(cars[g], motion[g], own[g])
        to, kept, latent = node[g], from_memory[g], given[g]
        for d in range(width):
            to[d] = kept[d] + latent[d]
    product(own, weight, node)
    relu(node)


@kernel
def mix(
    graph: GraphWeights,
    node: Array,
    rows: IntArray,
    attention_bias: Array,
    senders: Array,
    alone: bool,
    activations: Activations,
) -> Array:
    """Return the embeddings (G, D) after the interaction net; all but *alone* leave their messages in *senders*.

    Args:
        graph: weights.
        node: (G, D) embeddings before it.
        rows: (G,) which of the agents they are.
        attention_bias: (A,) added to the scores.
        senders: (L, A, M) everybody's messages.
        alone: whether that is read of all but *rows*.
        activations: of all layers, (L, …), to be written; its messages hold what relative poses add.
    """
    wide = senders.shape[2]
    ends, sent = (
        np.empty((len(rows), 2 * wide), node.dtype),
        np.empty((len(attention_bias), wide), node.dtype),
    )
    for layer in range(len(graph.ends)):
        affine(node, graph.ends[layer], graph.ends_bias[layer], ends)
        place(senders[layer], 0, sent, 0, wide)
        for g in range(len(rows)):
            for m in range(wide):
                sent[rows[g], m] = ends[g, wide + m]
        if not alone:
            place(sent, 0, senders[layer], 0, wide)
        node = graph_attention(
            graph, layer, node, ends, sent, attention_bias, activations_of(activations, layer)
        )
    return node


@kernel
def gru_step(
    weight: Array, from_mixed: Array, controls: Array, from_memory: Array, gates: Array, memory: Array
) -> None:
    """Turn *memory* (G, D) into that after a step: a gated recurrent unit.

    Args:
        weight: (2, 3 D) of the controls in the gates.
        from_mixed: (G, 4 D) what is made of the mixed node.
        controls: (G, 2) of the step.
        from_memory: (G, 4 D) what is made of the memory.
        gates: (G, 3 D) to be written.
        memory: (G, D).
    """
    count, width = memory.shape
    place(from_mixed, width, gates, 0, 3 * width)
    product(controls, weight, gates)
    for g in range(count):
        line, kept = gates[g], memory[g]
        both, last = from_memory[g][width : 3 * width], from_memory[g][3 * width :]
        reset, update, new = line[:width], line[width : 2 * width], line[2 * width :]
        for d in range(2 * width):
            line[d] = logistic(line[d] + both[d])
        for d in range(width):
            new[d] = tangent(new[d] + reset[d] * last[d])
        for d in range(width):
            kept[d] = new[d] + update[d] * (kept[d] - new[d])


@kernel
def roll(
    w: RollWeights,
    edge_weights: EdgeWeights,
    graph: GraphWeights,
    z: Array,
    h: Array,
    cars: Array,
    rows: IntArray,
    attention_bias: Array,
    trace: Trace,
    alone: bool,
    tape: Tape,
    futures: Array,
) -> None:
    """Roll out latents *z* (G, Z) and embeddings *h* (G, D) of *rows*.

    Args:
        w: weights.
        edge_weights: weights of relative poses.
        graph: weights of the interaction layers.
        z: (G, Z).
        h: (G, D).
        cars: (G, 6).
        rows: (G,) which of the agents they are.
        attention_bias: (A,) added to the scores: very negative where nobody is.
        trace: read where *alone*, written otherwise; *rows* are then all of its agents.
        alone: whether the others are where the trace has them.
        tape: to be written.
        futures: (T, G, 6) to be written: x, y, yaw, speed, acceleration, curvature.
    """
    affine(h, w.start_h, w.start_bias, tape.first)
    product(z, w.start_z, tape.first)
    for g in range(len(z)):
        for d in range(tape.first.shape[1]):
            tape.first[g, d] = tangent(tape.first[g, d])
    count, width = tape.first.shape
    memory, given = np.empty((count, width), z.dtype), np.empty((count, width), z.dtype)
    from_mixed, motion = np.empty((count, 4 * width), z.dtype), np.empty((count, 4), z.dtype)
    place(tape.first, 0, memory, 0, width)
    place(cars, 0, motion, 0, 4)
    affine(z, w.node_z, w.node_bias, given)
    raw = np.empty((len(z), 2), z.dtype)
    for g in range(count):
        motion[g, 3] = max(motion[g, 3], z.dtype.type(0.0))
    for k in range(len(futures)):
        slot = k % len(tape.memory)
        if not alone:
            place(motion, 0, trace.motion[k], 0, 4)
        place(memory, 0, tape.memory[slot], 0, width)
        affine(memory, w.from_memory, w.from_memory_bias, tape.from_memory[slot])
        begin_node(w.motion, cars, motion, tape.from_memory[slot], given, tape.node[slot])
        edge_features(edge_weights, trace.motion[k], rows, tape.message[slot])
        mixed = mix(
            graph, tape.node[slot], rows, attention_bias, trace.senders[k], alone, activations_at(tape, slot)
        )
        affine(mixed, w.from_mixed, w.from_mixed_bias, from_mixed)
        place(from_mixed, 0, tape.hidden[slot], 0, width)
        relu(tape.hidden[slot])
        affine(tape.hidden[slot], w.act, w.act_bias, raw)
        for g in range(len(z)):
            driven = tape.driven[slot, g]
            drive(cars[g], w.limits, raw[g], motion[g], driven)
            futures[k, g, 4], futures[k, g, 5] = driven[4], driven[5]
            raw[g, 0], raw[g, 1] = driven[4], driven[5]
        place(motion, 0, futures[k], 0, 4)
        gru_step(w.controls, from_mixed, raw, tape.from_memory[slot], tape.gates[slot], memory)
