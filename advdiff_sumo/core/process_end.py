"""What ends a process, and what its exit code says."""

from __future__ import annotations

import signal

#: In place of the exit code of a worker whose end nobody saw, as the process that workers come from was gone before.
UNSEEN = 256


def hears_ctrl_c() -> bool:
    """Return whether Ctrl-C can reach this process; a worker is deaf to it."""
    return signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def how_it_ended(exit_code: int) -> str:
    """Return what an exit code says, as the end of a sentence."""
    if exit_code == UNSEEN:
        return "was lost with the process that workers come from, which was ended from outside"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    try:
        return f"was ended by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was ended by signal {-exit_code}"
