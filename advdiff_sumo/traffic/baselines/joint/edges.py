"""How agents look to each other, embedded: ``models.geometry.relative_features`` and the edge encoder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array, Linear, relu

_PLACE, _SPEED, _NEAR, _SOFT_M2 = 0.05, 0.1, 0.1, 1e-6


@dataclass(frozen=True)
class Looks:
    """What A agents see of each other; the first index is who looks.

    Attributes:
        cos, sin: (A, 1) of who looks.
        ahead, left: (A, A) place in metres.
        far: (A, A) distance.
        same, across: (A, A) cosine and sine of the angle between.
        pace: (A,) scaled speed.
        near: (A, A) compressed distance.
        hidden, embedded: (A, A, E) both layers of the encoder.
    """

    cos: Array
    sin: Array
    ahead: Array
    left: Array
    far: Array
    same: Array
    across: Array
    pace: Array
    near: Array
    hidden: Array
    embedded: Array


class Edges:
    """The edge encoder.

    Args:
        net: whose it is.
    """

    def __init__(self, net: InteractionNet) -> None:
        self._first, self._second = Linear.of(net.edges.net[0]), Linear.of(net.edges.net[2])

    def look(self, motion: Array) -> Looks:
        """Return what agents at *motion* (A, 4) see of each other."""
        east, north = (motion[None, :, i] - motion[:, None, i] for i in (0, 1))
        cos, sin = np.cos(motion[:, 2]), np.sin(motion[:, 2])
        mine, my = cos[:, None], sin[:, None]
        ahead, left = mine * east + my * north, mine * north - my * east
        far = np.sqrt(ahead * ahead + left * left + _SOFT_M2)
        same, across = mine * cos + my * sin, mine * sin - my * cos
        pace, near = _SPEED * motion[:, 3], np.exp(-_NEAR * far)
        features = np.empty((*far.shape, RELATIVE_FEATURES), motion.dtype)
        features[..., 0], features[..., 1], features[..., 2] = _PLACE * ahead, _PLACE * left, near
        features[..., 3], features[..., 4] = same, across
        features[..., 5], features[..., 6] = pace * same, pace * across
        features[..., 8] = pace[:, None]
        features[..., 7] = features[..., 5] - features[..., 8]
        hidden = relu(self._first(features.reshape(-1, RELATIVE_FEATURES)))
        embedded = relu(self._second(hidden)).reshape(*far.shape, -1)
        return Looks(mine, my, ahead, left, far, same, across, pace, near, hidden, embedded)

    def look_back(self, looks: Looks, grad: Array) -> Array:
        """Return the gradient (A, 4) of the motion for *grad* (A, A, E) of what is embedded."""
        by = (grad * (looks.embedded > 0.0)).reshape(-1, grad.shape[-1]) @ self._second.back
        by = (by * (looks.hidden > 0.0)) @ self._first.back
        gradient = by.reshape(*looks.far.shape, RELATIVE_FEATURES)
        nearer = -_NEAR * gradient[..., 2] * looks.near / looks.far
        ahead = _PLACE * gradient[..., 0] + nearer * looks.ahead
        left = _PLACE * gradient[..., 1] + nearer * looks.left
        east, north = looks.cos * ahead - looks.sin * left, looks.sin * ahead + looks.cos * left
        along = gradient[..., 5] + gradient[..., 7]
        same, across = gradient[..., 3] + looks.pace * along, gradient[..., 4] + looks.pace * gradient[..., 6]
        turn = looks.same * across - looks.across * same
        theirs = looks.same * along + looks.across * gradient[..., 6]
        out = np.empty((len(looks.far), 4), grad.dtype)
        out[:, 0] = east.sum(0) - east.sum(1)
        out[:, 1] = north.sum(0) - north.sum(1)
        out[:, 2] = turn.sum(0) - turn.sum(1) + (ahead * looks.left - left * looks.ahead).sum(1)
        out[:, 3] = _SPEED * (theirs.sum(0) + (gradient[..., 8] - gradient[..., 7]).sum(1))
        return out
