"""Choose names for result folders that the user did not name."""

from __future__ import annotations

import re
from pathlib import Path

RUNS = Path("runs")
_MAX_CHARACTERS = 60  # of a word in a folder's name


def run_words(net: str, target: str, background: str, seed: int) -> tuple[str, ...]:
    """Return the words after which a run's folder is named."""
    return Path(net).name.split(".net.xml")[0], target, background, f"s{seed}"


def free_folder(*words: str) -> Path:
    """Return a path in ``RUNS`` that is named after *words* and does not exist yet."""
    path, number = named_folder(*words), 2
    name = path.name
    while path.exists():
        path, number = RUNS / f"{name}-{number}", number + 1
    return path


def named_folder(*words: str) -> Path:
    """Return the path in ``RUNS`` that is named after *words*."""
    return RUNS / "-".join(re.sub(r"[^\w.-]+", "-", word)[:_MAX_CHARACTERS].strip("-") for word in words)
