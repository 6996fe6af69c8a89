"""Names for folders of results that nobody named."""

from __future__ import annotations

import re
from pathlib import Path

RUNS = Path("runs")
_LONGEST = 60


def run_words(net: str, target: str, background: str, seed: int) -> tuple[str, ...]:
    """Return the words that a run's folder is named after."""
    return Path(net).name.split(".net.xml")[0], target, background, f"s{seed}"


def free_folder(*words: str) -> Path:
    """Return a path in ``RUNS`` that is named after *words* and does not exist."""
    path, number = named_folder(*words), 2
    name = path.name
    while path.exists():
        path, number = RUNS / f"{name}-{number}", number + 1
    return path


def named_folder(*words: str) -> Path:
    """Return a path in ``RUNS`` that is named after *words*."""
    return RUNS / "-".join(re.sub(r"[^\w.-]+", "-", word)[:_LONGEST].strip("-") for word in words)
