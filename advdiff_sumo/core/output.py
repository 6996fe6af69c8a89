"""Standard output and error of this process, which a planner may have closed or removed."""

from __future__ import annotations

import contextlib
import sys


def flush_output() -> None:
    """Write out what standard output and error hold, as far as they are open."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError, OSError):
            stream.flush()
