"""The command ``advdiff-sumo``, also as ``python -m advdiff_sumo``."""

from __future__ import annotations

import os
import signal
from types import FrameType

from advdiff_sumo.core.errors import INTERRUPTED, KEPT


def main() -> None:
    """Run the command line; Ctrl-C is heard from the beginning, as its imports take a second or two."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heard:
        signal.signal(signal.SIGINT, _leave)
    from advdiff_sumo.cli.main import main as command_line

    if heard:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command_line()


def _leave(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - what a handler is given
    """Leave at once: nothing has been begun, and libraries that are half imported cannot be unwound."""
    os.write(2, f"{KEPT}\n".encode())
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
