"""What a command says after Ctrl-C: what is left, and how to go on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from advdiff_sumo.core.errors import KEPT

_NOTHING = "interrupted before anything had finished; no folder is left"


class Interrupted(Exception):  # noqa: N818 - no error
    """Ctrl-C ended a command; the message is for the user."""


@contextmanager
def says_how_to_go_on(command: Callable[[], str | None]) -> Iterator[None]:
    """Let Ctrl-C in the block end with the *command* that goes on; None where nothing is left to go on with.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    try:
        yield
    except KeyboardInterrupt:
        again = command()
        raise Interrupted(_NOTHING if again is None else f"{KEPT}; go on with {again}") from None
