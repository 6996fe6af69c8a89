"""What an agent knows of its own motion since now: place and heading in the frame that it had, and speed."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array

_PLACE, _SPEED = 0.05, 0.1


def own_motion(begin: Array, motion: Array) -> Array:
    """Return (A, 6) of agents that were at *begin* (A, 4) and are at *motion* (A, 4)."""
    cos, sin = np.cos(begin[:, 2]), np.sin(begin[:, 2])
    east, north = (_PLACE * (motion[:, i] - begin[:, i]) for i in (0, 1))
    turn = motion[:, 2] - begin[:, 2]
    columns = (
        cos * east + sin * north,
        cos * north - sin * east,
        np.cos(turn),
        np.sin(turn),
        _SPEED * motion[:, 3],
        _SPEED * (motion[:, 3] - begin[:, 3]),
    )
    return np.stack(columns, axis=-1)


def own_motion_back(begin: Array, motion: Array, grad: Array) -> Array:
    """Return the gradient (A, 4) of the motion for *grad* (A, 6)."""
    cos, sin = np.cos(begin[:, 2]), np.sin(begin[:, 2])
    turn = motion[:, 2] - begin[:, 2]
    columns = (
        _PLACE * (cos * grad[:, 0] - sin * grad[:, 1]),
        _PLACE * (sin * grad[:, 0] + cos * grad[:, 1]),
        np.cos(turn) * grad[:, 3] - np.sin(turn) * grad[:, 2],
        _SPEED * (grad[:, 4] + grad[:, 5]),
    )
    return np.stack(columns, axis=-1)
