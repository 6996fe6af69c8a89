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


class Activations(NamedTuple):
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
        from_memory, back_from_memory, from_memory_bias: the memory's part of the node (D), then of the gates (3 D).
        motion, back_motion: of the features of the own motion in the node.
        from_mixed, back_from_mixed, from_mixed_bias: mixed node to action's hidden part (D) and gates (3 D).
        act, back_act, act_bias: the action's last product.
        controls, back_controls: of both controls in the gates, scaled.
        limits: (3,) of ``vehicle``.
    """

    start_h: Array
    start_z: Array
    back_start_z: Array
    start_bias: Array
    node_z: Array
    back_node_z: Array
    node_bias: Array
    from_memory: Array
    back_from_memory: Array
    from_memory_bias: Array
    motion: Array
    back_motion: Array
    from_mixed: Array
    back_from_mixed: Array
    from_mixed_bias: Array
    act: Array
    back_act: Array
    act_bias: Array
    controls: Array
    back_controls: Array
    limits: Array


class ActWeights(NamedTuple):
    """Those of :class:`RollWeights` that the gradient of a step's controls needs."""

    back_act: Array
    back_controls: Array
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
        from_memory: (S, G, 4 D) the memory's part of node and gates.
        node: (S, G, D) after its ReLU.
        hidden: (S, G, D) the action's.
        gates: (S, G, 3 D) reset, update, and the new memory.
        driven: (S, G, 8) of ``vehicle.drive``.
        message: (S, L, G, A, M) and the rest as in :class:`Activations`.
        weight: (S, L, G, H, A)
        normal: (S, L, G, D)
        deviation: (S, L, G)
        inner: (S, L, G, D)
    """

    first: Array
    memory: Array
    from_memory: Array
    node: Array
    hidden: Array
    gates: Array
    driven: Array
    message: Array
    weight: Array
    normal: Array
    deviation: Array
    inner: Array


class Trace(NamedTuple):
    """Where everybody was at the beginning of each step (T, A, 4), and everybody's messages (T, L, A, M)."""

    motion: Array
    senders: Array


@kernel
def activations_at(tape: Tape, slot: int) -> Activations:
    """Return the activations of all layers in a step, (L, …)."""
    return Activations(
        tape.message[slot], tape.weight[slot], tape.normal[slot], tape.deviation[slot], tape.inner[slot]
    )


@kernel
def activations_of(activations: Activations, layer: int) -> Activations:
    """Return one layer's part."""
    return Activations(
        activations.message[layer],
        activations.weight[layer],
        activations.normal[layer],
        activations.deviation[layer],
        activations.hidden[layer],
    )
