"""The safe gap of a following driver (RSS, Shalev-Shwartz, Shammah and Shashua 2017, arXiv:1708.06374)."""

from __future__ import annotations

from typing import overload

import numpy as np

from advdiff_sumo.core.arrays import FloatArray

#: Response time of a driver before braking (s).
RESPONSE_S = 0.75
#: Deceleration that both drivers are expected to reach (m/s²).
BRAKE_MPS2 = 6.0


@overload
def safe_gap_m(follower_mps: float, leader_mps: float) -> float: ...
@overload
def safe_gap_m(follower_mps: FloatArray, leader_mps: FloatArray) -> FloatArray: ...
def safe_gap_m(follower_mps: float | FloatArray, leader_mps: float | FloatArray) -> float | FloatArray:
    """Return the gap that lets the follower stop behind a braking leader (Definition 1).

    v_f ρ + v_f² / 2b − v_l² / 2b, at least 0, with ρ = ``RESPONSE_S``, b = ``BRAKE_MPS2`` for both, and no acceleration
    during the response.
    """
    follower, leader = np.asarray(follower_mps), np.asarray(leader_mps)
    gap = np.maximum(0.0, follower * RESPONSE_S + (follower**2 - leader**2) / (2.0 * BRAKE_MPS2))
    return gap if gap.ndim else float(gap)
