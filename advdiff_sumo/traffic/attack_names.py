"""Names of attacks, apart from their code: the command line lists them without importing it."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

FurtherAttack: TypeAlias = Literal[
    "crossing",
    "blocked-lane",
    "stop-and-go",
    "cut-out",
    "queue",
    "oncoming",
    "double",
    "slow-merge",
    "pull-out",
    "close-pass",
    "blind-spot",
    "short-gaps",
]
"""Attacks under a licence besides "any", "hard-stop" and "cut-in"."""
Kind: TypeAlias = Literal["any", "hard-stop", "cut-in", FurtherAttack]
"""Attacks of ``scripted``, and of ``diffusion`` under a licence."""
KIND_NAMES: tuple[str, ...] = get_args(Kind)
RECKLESS_ATTACKS = ("any", "cut-in", "rear-end", "head-on", "junction", "brake")
"""Attacks for which the guide of ``diffusion`` has cost terms."""
