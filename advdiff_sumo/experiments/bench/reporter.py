"""Interface by which a bench reports its progress; the command line draws progress bars from it."""

from __future__ import annotations

from typing import Protocol


class ProgressReporter(Protocol):
    """Receives stages and their steps."""

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Begin a stage of *total* steps, of which *done* were finished earlier."""
        ...

    def step(self, words: str = "") -> None:
        """Count one more step; *words* describe the state."""
        ...

    def say(self, sentence: str) -> None:
        """Show a message to the user."""
        ...


class Silent:
    """Ignores all reports."""

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Do nothing."""

    def step(self, words: str = "") -> None:
        """Do nothing."""

    def say(self, sentence: str) -> None:
        """Do nothing."""
