"""The seed tree run → episode → component, from which all random generators are made."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SeedTree:
    """A node of the seed tree; children are named, so that a new one never changes the seeds of others.

    Attributes:
        root: the run's seed.
        path: names from the root to this node.
    """

    root: int
    path: tuple[str, ...] = ()

    def child(self, *names: object) -> SeedTree:
        """Return the node below this one under *names*."""
        return SeedTree(self.root, (*self.path, *(str(n) for n in names)))

    def integer(self, bits: int = 31) -> int:
        """Return this node's seed in [0, 2**bits), for programs that need an integer (SUMO: 31 bits)."""
        text = "\x1f".join((str(self.root), *self.path)).encode()
        return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") >> (64 - bits)

    def generator(self) -> np.random.Generator:
        """Return a new random generator seeded by this node."""
        return np.random.default_rng(self.integer(64))
