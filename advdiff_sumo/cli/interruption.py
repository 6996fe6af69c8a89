"""What a command says after Ctrl-C: what is left, and how to go on."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from advdiff_sumo.core.errors import KEPT

_NOTHING = "interrupted before anything had finished; no folder is left"
_RESUME = "--resume"


class Interrupted(Exception):  # noqa: N818 - no error
    """Ctrl-C ended a command; the message is for the user."""


@contextmanager
def says_how_to_go_on(command: Callable[[], str | None], nothing: str = _NOTHING) -> Iterator[None]:
    """Let Ctrl-C in the block end with the *command* that goes on.

    Args:
        command: returns it, or None where nothing is left to go on with.
        nothing: what is said then.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    try:
        yield
    except KeyboardInterrupt:
        again = command()
        raise Interrupted(nothing if again is None else f"{KEPT}; go on with {again}") from None


@contextmanager
def training_into(folder: Path) -> Iterator[None]:
    """Let Ctrl-C in the block end with the command that goes on with the training in *folder*: as typed, resumed.

    Raises:
        Interrupted: in place of KeyboardInterrupt.
    """
    from advdiff_sumo.training.checkpoint import NAME  # late: --help needs no PyTorch

    nothing = f"interrupted before the first checkpoint; begin again, with another --out than {folder}"
    typed = [word for word in sys.argv[1:] if word != _RESUME]
    with says_how_to_go_on(
        lambda: shlex.join(["advdiff-sumo", *typed, _RESUME]) if (folder / NAME).exists() else None, nothing
    ):
        yield
