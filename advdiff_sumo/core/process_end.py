"""Ends of processes: Ctrl-C and exit codes."""

from __future__ import annotations

import signal

#: Replaces the exit code of a worker that is unknown because the fork server ended before.
UNSEEN = 256


def hears_ctrl_c() -> bool:
    """Return whether this process reacts to Ctrl-C; workers ignore it."""
    return signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def how_it_ended(exit_code: int) -> str:
    """Return the meaning of an exit code, as the end of a sentence."""
    if exit_code == UNSEEN:
        return "was lost with the process that workers come from, which was ended from outside"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    try:
        return f"was ended by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was ended by signal {-exit_code}"
