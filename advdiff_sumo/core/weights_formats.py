"""Formats of weights files, as named in their headers, and their contents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from advdiff_sumo.core.errors import WeightsError

CONTENTS: Mapping[str, str] = {
    "advdiff-weights-1": "a traffic model",
    "advdiff-simnet-1": "the network of SimNet",
    "advdiff-reward-1": "a reward model",
    "advdiff-failures-1": "what a warm-up learned of encounters",
    "advdiff-actor-1": "an actor of Adv-RL",
    "advdiff-training-1": "the checkpoint of a training",
}
"""Content of a file, by format."""


def of_another_format(path: Path, kind: str, actual: str, remedy: str) -> WeightsError:
    """Return the error for a file of format *actual* instead of *kind*; *remedy* is used if a format is unknown."""
    problem = f"is not of the format {kind}"
    if actual not in CONTENTS or kind not in CONTENTS:
        return WeightsError(path, problem, remedy)
    return WeightsError(
        path, f"{problem}, it holds {CONTENTS[actual]}", f"name a file that holds {CONTENTS[kind]}"
    )
