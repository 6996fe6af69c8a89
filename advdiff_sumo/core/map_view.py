"""How much of the map learned models see, as maps, windows and networks agree on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

MapView: TypeAlias = Literal["near", "far"]
MAP_PIECES: Mapping[MapView, tuple[int, int]] = {"near": (28, 12), "far": (44, 20)}
"""Lane pieces and pieces of road edges that an agent sees at most: 60 m around it, and all that is driven in 6 s."""
