"""What compiled loops are given: weights by name, and what a pass leaves for its gradient.

Weights are (in, out) as they multiply forward, and (out, in), named ``back_…``, as they multiply backward.
"""

from __future__ import annotations

from typing import NamedTuple

from advdiff_sumo.diffusion.compiled.kernel import Array, kernel


class GraphWeights(NamedTuple):
    """Weights of L interaction layers, (L, in, out) and (L, out, in).

    Attributes:
        ends, back_ends, ends_bias: of what an agent adds to messages as receiver (M), then as sender (M).
        score: (L, H, M).
        out, back_out, out_bias: of the gathered messages.
        scale, shift, eps: of the norm.
        first, back_first, first_bias: of the first product after the norm.
        second, back_second, second_bias: of the second.
    """

    ends: Array
    back_ends: Array
    ends_bias: Array
    score: Array
    out: Array
    back_out: Array
    out_bias: Array
    scale: Array
    shift: Array
    eps: Array
    first: Array
    back_first: Array
    first_bias: Array
    second: Array
    back_second: Array
    second_bias: Array


class Heard(NamedTuple):
    """What the gradient of one layer needs.

    Attributes:
        message: (G, A, M) after the ReLU.
        weight: (G, H, A) attention.
        normal: (G, D) the norm's input, less its mean, over its deviation.
        deviation: (G,) 1 over that.
        hidden: (G, D) inside the last two products, after the ReLU.
    """

    message: Array
    weight: Array
    normal: Array
    deviation: Array
    hidden: Array


class RollWeights(NamedTuple):
    """Weights of one decoder.

    Attributes:
        start_h, start_z, back_start_z, start_bias: the first memory.
        node_z, back_node_z, node_bias: of the latent in the node.
        held, back_held, held_bias: what is made of the memory: the node's part (D), then the gates' (3 D).
        motion, back_motion: of the features of the own motion in the node.
        told, back_told, told_bias: what is made of the mixed node: the action's hidden part (D), the gates' (3 D).
        act, back_act, act_bias: the action's last product.
        done, back_done: of both controls in the gates, scaled.
        limits: (3,) of ``vehicle``.
    """

    start_h: Array
    start_z: Array
    back_start_z: Array
    start_bias: Array
    node_z: Array
    back_node_z: Array
    node_bias: Array
    held: Array
    back_held: Array
    held_bias: Array
    motion: Array
    back_motion: Array
    told: Array
    back_told: Array
    told_bias: Array
    act: Array
    back_act: Array
    act_bias: Array
    done: Array
    back_done: Array
    limits: Array


class ActWeights(NamedTuple):
    """Those of :class:`RollWeights` that the gradient of a step's controls needs."""

    back_act: Array
    back_done: Array
    limits: Array


class EdgeWeights(NamedTuple):
    """Weights of how relative poses are embedded.

    Attributes:
        edge_features, edge_bias: relative poses (8) to the hidden part of their embedding.
        look, look_bias: that to the embedding.
        edge: (L, E, M) embeddings to what they add to messages.
    """

    edge_features: Array
    edge_bias: Array
    look: Array
    look_bias: Array
    edge: Array


class Tape(NamedTuple):
    """What a roll-out leaves for its gradient, a slot for each step; with one slot, of the last step.

    Attributes:
        first: (G, D) the first memory.
        memory: (S, G, D) before the step.
        held: (S, G, 4 D) made of it.
        node: (S, G, D) after its ReLU.
        hidden: (S, G, D) the action's.
        gates: (S, G, 3 D) reset, update, and the new memory.
        done: (S, G, 8) of ``vehicle.drive``.
        message: (S, L, G, A, M) and the rest as in :class:`Heard`.
        weight: (S, L, G, H, A)
        normal: (S, L, G, D)
        deviation: (S, L, G)
        inner: (S, L, G, D)
    """

    first: Array
    memory: Array
    held: Array
    node: Array
    hidden: Array
    gates: Array
    done: Array
    message: Array
    weight: Array
    normal: Array
    deviation: Array
    inner: Array


class Trace(NamedTuple):
    """Where everybody was at the beginning of each step (T, A, 4), and what he said (T, L, A, M)."""

    motion: Array
    senders: Array


@kernel
def heard_at(tape: Tape, slot: int) -> Heard:
    """Return what all layers heard in a step, (L, …)."""
    return Heard(
        tape.message[slot], tape.weight[slot], tape.normal[slot], tape.deviation[slot], tape.inner[slot]
    )


@kernel
def heard_in(heard: Heard, layer: int) -> Heard:
    """Return one layer's part."""
    return Heard(
        heard.message[layer],
        heard.weight[layer],
        heard.normal[layer],
        heard.deviation[layer],
        heard.hidden[layer],
    )
