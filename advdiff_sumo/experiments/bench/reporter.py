"""How a bench tells what it is doing; the command line draws bars from it."""

from __future__ import annotations

from typing import Protocol


class ProgressReporter(Protocol):
    """Told of stages and their steps."""

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """A stage of *total* steps begins, *done* of them done before."""
        ...

    def step(self, words: str = "") -> None:
        """One step more; *words* say how things stand."""
        ...

    def say(self, sentence: str) -> None:
        """Something that the user should know."""
        ...


class Silent:
    """Tells nobody."""

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Do nothing."""

    def step(self, words: str = "") -> None:
        """Do nothing."""

    def say(self, sentence: str) -> None:
        """Do nothing."""
