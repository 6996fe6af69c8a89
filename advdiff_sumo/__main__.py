"""Start the command ``advdiff-sumo``, also as ``python -m advdiff_sumo``."""

from __future__ import annotations

import os
import signal
from types import FrameType

from advdiff_sumo.core.errors import INTERRUPTED, INTERRUPTION


def main() -> None:
    """Run the command line; Ctrl-C also works during its imports, which take a second or two."""
    is_default_handler = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_default_handler:
        signal.signal(signal.SIGINT, _leave)
    from advdiff_sumo.cli.main import main as command_line

    if is_default_handler:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command_line()


def _leave(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the arguments of a signal handler
    """End the process at once: no work has begun, and partly imported libraries cannot be cleaned up."""
    os.write(2, f"{INTERRUPTION}\n".encode())
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
