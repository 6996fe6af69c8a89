"""What the system refuses a command: rights, space, names that are no text."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Mapping

from advdiff_sumo.core.errors import InputError, is_disk_full, os_reason

_RIGHTS = "choose another path, or ask for the rights to this one and its folder"
_REMEDIES: Mapping[int | None, str] = {
    errno.EACCES: _RIGHTS,
    errno.EPERM: _RIGHTS,
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EFBIG: "allow larger files (ulimit -f)",
    errno.EMFILE: "allow more open files (ulimit -n)",
}
"""Number of an error of the system → what to do; a full disk has a remedy of its own."""


def checked_folder() -> str:
    """Return the working folder, after a check that it and the words of the command line are text.

    Python reads other bytes as surrogates, which neither pyarrow nor a file of settings can hold.

    Raises:
        InputError: one is no text, or there is no working folder any more.
    """
    try:
        here = os.getcwd()  # noqa: PTH109 - text
    except FileNotFoundError:
        raise InputError("the working folder has been deleted; change to another one") from None
    for name in (here, *sys.argv[1:]):
        try:
            name.encode()
        except UnicodeEncodeError:
            coding = sys.getfilesystemencoding()
            remedy = "rename it" if coding == "utf-8" else "set LC_ALL=C.UTF-8"
            shown = os.fsencode(name).decode(errors="backslashreplace")
            raise InputError(f"{shown}: its bytes are no text in {coding}; {remedy}") from None
    return here


def system_error(error: OSError) -> str | None:
    """Return what the system refused and what to do; None if *error* comes from a library, not from the system."""
    space = "free some space, or choose another path" if is_disk_full(error) else None
    remedy = _REMEDIES.get(error.errno, space)
    if error.filename is None and remedy is None:
        return None
    place = f"{error.filename}: " if error.filename is not None else ""
    return f"{place}{os_reason(error)}{f'; {remedy}' if remedy else ''}"
