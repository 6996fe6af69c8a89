"""Sizes of the map extract that learned models perceive; maps, windows and networks use the same ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

MapView: TypeAlias = Literal["near", "far"]
MAP_PIECES: Mapping[MapView, tuple[int, int]] = {"near": (28, 12), "far": (44, 20)}
"""Greatest number of lane pieces and of road-edge pieces per agent: "near" covers 60 m around it, "far" all it can
reach in 6 s."""
