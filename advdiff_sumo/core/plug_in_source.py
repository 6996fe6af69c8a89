"""Check a planner's methods, and find the file and line of its or a policy's own code, for error messages."""

from __future__ import annotations

import errno
import inspect
import re
import sysconfig
import traceback
from functools import cache
from pathlib import Path
from types import CodeType

_OUR_PACKAGE = str(Path(__file__).parents[1])
#: Arguments with which a planner's methods are called.
PLANNER_CALLS = {"start": ("road", "scene", "rng"), "plan": ("road", "scene", "memory", "rng")}
#: A call in the output of Python's fault handler.
_CALL = re.compile(r'File "([^"]+)", line (\d+) in (\S+)')
_INSTALLED = {"site-packages", "dist-packages"}


def call_problem(planner: object) -> str:
    """Return why *planner* cannot be called as a planner, as the end of a sentence; "" if it can."""
    missing = [method for method in PLANNER_CALLS if not callable(getattr(planner, method, None))]
    if missing:
        return f"lacks {' and '.join(missing)}"
    problem = arguments_problem(planner)
    return f"cannot be used: {problem}" if problem else ""


def arguments_problem(planner: object) -> str:
    """Return which method of *planner* does not take the arguments of a planner's, as a sentence; "" if all do."""
    for method, arguments in PLANNER_CALLS.items():
        try:
            inspect.signature(getattr(planner, method)).bind(*arguments)
        except ValueError:  # some methods written in C have none
            continue
        except TypeError as error:
            return f"{method} is called with {', '.join(arguments)}, and cannot be so: {error}"
    return ""


def described(error: BaseException) -> str:
    """Return the type and the text of *error* in one line."""
    return f"{type(error).__name__}{message_of(error)}"


def message_of(error: BaseException) -> str:
    """Return ": " and the text of *error* in one line; "" if it has none, as Python's MemoryError."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # noqa: BLE001 - a plug-in's own exception class may be broken
        text = ""
    return f": {text}" if text else ""


def lacks_memory(error: BaseException) -> bool:
    """Return whether *error* means that memory ran out, in Python, the system, NumPy or PyTorch.

    PyTorch raises a RuntimeError on the CPU, and its own OutOfMemoryError on a GPU.
    """
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    is_from_gpu = type(error).__name__ == "OutOfMemoryError"
    return isinstance(error, RuntimeError) and (is_from_gpu or "can't allocate memory" in described(error))


def raised_at(error: BaseException, plug_in: object) -> str:
    """Return " (FILE, line N, FUNCTION)" of the innermost call in the plug-in's own code; "" if there is none.

    If the plug-in is a wrapper of this package, the wrapped planner or policy counts, as in :func:`planned_at`.
    """
    frames = traceback.extract_tb(error.__traceback__)
    own_frames = [frame for frame in frames if not _is_library(frame.filename)]
    if not own_frames:  # the plug-in is installed as a library, or part of this package
        source = _source_of(type(_unwrapped(plug_in)))
        own_frames = [frame for frame in frames if frame.filename == source]
    if not own_frames:
        return ""
    innermost = own_frames[-1]
    return f" ({Path(innermost.filename).name}, line {innermost.lineno}, {innermost.name})"


def planned_at(plug_in: object) -> str:
    """Return " (FILE, line N, plan)" of the method that plans; "" for a plug-in of this package."""
    code = _code_of_plan(_unwrapped(plug_in))
    if code is None or code.co_filename.startswith(_OUR_PACKAGE):
        return ""
    return f" ({Path(code.co_filename).name}, line {code.co_firstlineno}, plan)"


def crashed_at(stack: str) -> str:
    """Return " (FILE, line N, FUNCTION)" from a stack of Python's fault handler, whose innermost call is the first."""
    calls = ((file, line, name) for file, line, name in _CALL.findall(stack) if not _is_library(file))
    return next((f" ({Path(file).name}, line {line}, {name})" for file, line, name in calls), "")


def _unwrapped(plug_in: object) -> object:
    """Return the planner or policy in wrappers of this package: their attribute ``planner`` or ``policy``."""
    code = _code_of_plan(plug_in)
    inner = getattr(plug_in, "planner", getattr(plug_in, "policy", None))
    if inner is None or code is None or not code.co_filename.startswith(_OUR_PACKAGE):
        return plug_in
    return _unwrapped(inner)


def _code_of_plan(plug_in: object) -> CodeType | None:
    code = getattr(getattr(type(plug_in), "plan", None), "__code__", None)
    return code if isinstance(code, CodeType) else None


@cache
def _standard_library() -> str:
    return sysconfig.get_path("stdlib")


def _is_library(filename: str) -> bool:
    """Return whether a file belongs to this package, the standard library or an installed package."""
    is_installed = not _INSTALLED.isdisjoint(Path(filename).parts)
    return is_installed or filename.startswith((_OUR_PACKAGE, _standard_library(), "<"))


def _source_of(kind: type) -> str:
    try:
        return inspect.getsourcefile(kind) or ""
    except (TypeError, OSError):
        return ""
