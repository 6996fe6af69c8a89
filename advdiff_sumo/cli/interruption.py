"""The message after Ctrl-C: what was kept, and the command that continues."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from advdiff_sumo.core.errors import INTERRUPTION

KEPT = f"{INTERRUPTION}; what had finished is kept"
_NOTHING_KEPT = "interrupted before anything had finished; no folder is left"
_RESUME = "--resume"


class Interrupted(Exception):  # noqa: N818 - it is not an error
    """Ctrl-C ended a command; the exception's text is shown to the user."""


@contextmanager
def explains_how_to_continue(
    command: Callable[[], str | None], nothing: str = _NOTHING_KEPT
) -> Iterator[None]:
    """Replace KeyboardInterrupt in the block by a message with the command that continues the work.

    Args:
        command: returns this command, or None if nothing was kept that could be continued.
        nothing: the message if nothing was kept.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    try:
        yield
    except KeyboardInterrupt:
        continuation = command()
        message = nothing if continuation is None else f"{KEPT}; go on with {continuation}"
        raise Interrupted(message) from None


@contextmanager
def same_command_continues(folder: Path) -> Iterator[None]:
    """Replace KeyboardInterrupt in the block by a message with the typed command, which runs what *folder* lacks.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    typed = shlex.join(["advdiff-sumo", *sys.argv[1:]])
    with explains_how_to_continue(lambda: typed if folder.exists() else None):
        yield


@contextmanager
def training_into(folder: Path) -> Iterator[None]:
    """Replace KeyboardInterrupt in the block by a message with the typed command and ``--resume``.

    Args:
        folder: the training; before its first checkpoint the message says to begin again.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    from advdiff_sumo.training.checkpoint import NAME  # late: --help needs no PyTorch

    nothing = f"interrupted before the first checkpoint; begin again, with another --out than {folder}"
    typed = [word for word in sys.argv[1:] if word != _RESUME]
    with explains_how_to_continue(
        lambda: shlex.join(["advdiff-sumo", *typed, _RESUME]) if (folder / NAME).exists() else None, nothing
    ):
        yield
