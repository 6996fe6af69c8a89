"""The gradient of the decoder's roll-out, by hand: what ``rollout`` did, from its last step to its first."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import IntArray
from advdiff_sumo.diffusion.compiled.graph_kernel import graph_attention_back
from advdiff_sumo.diffusion.compiled.kernel import Array, clear, keep, kernel, place, product
from advdiff_sumo.diffusion.compiled.records import (
    Activations,
    ActWeights,
    GraphWeights,
    RollWeights,
    Tape,
    activations_at,
    activations_of,
)
from advdiff_sumo.diffusion.compiled.vehicle_kernel import MOTION, drive_back, features_back


@kernel
def gates_back(
    gates: Array, from_memory: Array, before: Array, memory: Array, by: Array, kept: Array
) -> None:
    """Set the gates' part of *by* and of *kept* for the gradient *memory*, and leave what goes past them there.

    Args:
        gates: (G, 3 D) of the step.
        from_memory: (G, 4 D) what was made of the memory.
        before: (G, D) the memory before the step.
        memory: (G, D) its gradient after the step.
        by: (G, 4 D) gradient of the mixed node's part.
        kept: (G, 4 D) gradient of the memory's part.
    """
    count, width = memory.shape
    one = memory.dtype.type(1.0)
    for g in range(count):
        line, grad, to, own = gates[g], memory[g], by[g], kept[g]
        past, last = before[g], from_memory[g]
        for d in range(width):
            reset, update, new = line[d], line[width + d], line[2 * width + d]
            by_new = grad[d] * (one - update) * (one - new * new)
            by_reset = by_new * last[3 * width + d] * reset * (one - reset)
            by_update = grad[d] * (past[d] - new) * update * (one - update)
            to[width + d] = own[width + d] = by_reset
            to[2 * width + d] = own[2 * width + d] = by_update
            to[3 * width + d], own[3 * width + d] = by_new, by_new * reset
            grad[d] *= update


@kernel
def mix_back(graph: GraphWeights, node: Array, rows: IntArray, activations: Activations) -> Array:
    """Return the gradient (G, D) of embeddings before the interaction net for that, *node*, of those after it."""
    agents, wide = activations.message.shape[2:]
    ends, sender = np.empty((len(rows), 2 * wide), node.dtype), np.empty((agents, wide), node.dtype)
    for layer in range(len(graph.ends) - 1, -1, -1):
        clear(sender)
        node, receiver = graph_attention_back(graph, layer, node, activations_of(activations, layer), sender)
        place(receiver, 0, ends, 0, wide)
        for g in range(len(rows)):
            for m in range(wide):
                ends[g, wide + m] = sender[rows[g], m]
        product(ends, graph.back_ends[layer], node)
    return node


@kernel
def act_back(
    w: ActWeights, cars: Array, driven: Array, hidden: Array, by: Array, grad: Array, motion: Array
) -> None:
    """Set the action's part of *by* (G, 4 D), and turn *motion* (G, 4) after a step into that before it.

    Args:
        w: weights.
        cars: (G, 6).
        driven: (G, 8) the step.
        hidden: (G, D) the action's, after its ReLU.
        by: (G, 4 D) gradients of the mixed node's part; its gates' part is read.
        grad: (G, 6) gradients of what the step made.
        motion: (G, 4) gradient from the steps that follow.
    """
    count, width = hidden.shape
    raw, controls = np.empty((count, 2), by.dtype), np.empty((count, 2), by.dtype)
    gates, slope = np.empty((count, 3 * width), by.dtype), np.empty((count, width), by.dtype)
    place(by, width, gates, 0, 3 * width)
    clear(controls)
    clear(slope)
    product(gates, w.back_controls, controls)
    for g in range(count):
        for i in range(4):
            motion[g, i] += grad[g, i]
        controls[g, 0] += grad[g, 4]
        controls[g, 1] += grad[g, 5]
        drive_back(cars[g], w.limits, driven[g], motion[g], controls[g], raw[g])
    product(raw, w.back_act, slope)
    keep(slope, hidden)
    place(slope, 0, by, 0, width)


@kernel
def roll_back(
    w: RollWeights, graph: GraphWeights, cars: Array, rows: IntArray, tape: Tape, grad: Array
) -> Array:
    """Return the gradient (G, Z) of latents for *grad* (T, G, 6) of what :func:`roll` made of them."""
    count, width = tape.first.shape
    act = ActWeights(w.back_act, w.back_controls, w.limits)
    memory, given = np.empty((count, width), grad.dtype), np.empty((count, width), grad.dtype)
    motion, out = np.empty((count, 4), grad.dtype), np.empty((count, w.back_start_z.shape[1]), grad.dtype)
    clear(memory)
    clear(given)
    clear(motion)
    clear(out)
    by, from_memory = np.empty((count, 4 * width), grad.dtype), np.empty((count, 4 * width), grad.dtype)
    own = np.empty((count, MOTION), grad.dtype)
    for k in range(len(grad) - 1, -1, -1):
        gates_back(tape.gates[k], tape.from_memory[k], tape.memory[k], memory, by, from_memory)
        act_back(act, cars, tape.driven[k], tape.hidden[k], by, grad[k], motion)
        node = np.empty((count, width), grad.dtype)
        clear(node)
        product(by, w.back_from_mixed, node)
        node = mix_back(graph, node, rows, activations_at(tape, k))
        keep(node, tape.node[k])
        clear(own)
        product(node, w.back_motion, own)
        for g in range(count):
            features_back(cars[g], tape.driven[k, g], own[g], motion[g])
        place(node, 0, from_memory, 0, width)
        for g in range(count):
            for d in range(width):
                given[g, d] += node[g, d]
        product(from_memory, w.back_from_memory, memory)
    for g in range(count):
        for d in range(width):
            memory[g, d] *= 1.0 - tape.first[g, d] * tape.first[g, d]
    product(memory, w.back_start_z, out)
    product(given, w.back_node_z, out)
    return out
