"""What attacks may be asked for; names alone, as the command line lists them before it imports what drives them."""

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
]
"""What may be asked for under a licence besides "any", "hard-stop" and "cut-in"."""
Kind: TypeAlias = Literal["any", "hard-stop", "cut-in", FurtherAttack]
"""Attacks of ``scripted``; ``diffusion`` knows them under a licence."""
KIND_NAMES: tuple[str, ...] = get_args(Kind)
RECKLESS_ATTACKS = ("any", "cut-in", "rear-end", "head-on", "junction", "brake")
"""Attacks that the guide of ``diffusion`` has terms for."""
