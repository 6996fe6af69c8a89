"""File and line of a planner's or policy's own code, for messages about what it did wrong."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import CodeType

_OURS = str(Path(__file__).parents[1])
_CALL = re.compile(r'File "([^"]+)", line (\d+) in (\S+)')
_INSTALLED = {"site-packages", "dist-packages"}
_SERVERS = ("exec", "grpc")


def described(error: BaseException) -> str:
    """Return the type of *error* and what it says, in one line."""
    return f"{type(error).__name__}{message_of(error)}"


def message_of(error: BaseException) -> str:
    """Return ": " and what *error* says, in one line; "" where it says nothing, as Python's MemoryError does."""
    try:
        words = " ".join(str(error).split())
    except Exception:  # noqa: BLE001 - an exception of a plug-in's own may be broken, too
        words = ""
    return f": {words}" if words else ""


def lacks_memory(error: BaseException) -> bool:
    """Return whether *error* says that memory ran out, as Python, NumPy or PyTorch say it.

    PyTorch raises a plain RuntimeError on the CPU, and one of its own, OutOfMemoryError, on a GPU.
    """
    if isinstance(error, MemoryError):
        return True
    own = type(error).__name__ == "OutOfMemoryError"
    return isinstance(error, RuntimeError) and (own or "can't allocate memory" in described(error))


def raised_at(error: BaseException, plug_in: object) -> str:
    """Return " (FILE, line N, FUNCTION)" of the innermost call in the plug-in's own code; "" where there is none.

    One of our wrappers around a planner or policy is looked through, here and in :func:`planned_at`.
    """
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not _is_library(frame.filename)]
    if not own:  # installed beside other libraries, or one of ours
        source = _source_of(type(_unwrapped(plug_in)))
        own = [frame for frame in frames if frame.filename == source]
    return f" ({Path(own[-1].filename).name}, line {own[-1].lineno}, {own[-1].name})" if own else ""


def planned_at(plug_in: object) -> str:
    """Return " (FILE, line N, plan)" of the method that plans; "" for one of ours."""
    code = _code_of_plan(_unwrapped(plug_in))
    if code is None or code.co_filename.startswith(_OURS):
        return ""
    return f" ({Path(code.co_filename).name}, line {code.co_firstlineno}, plan)"


def crashed_at(stack: str) -> str:
    """Return the same of the stack that Python's fault handler wrote, its innermost call first."""
    calls = ((file, line, name) for file, line, name in _CALL.findall(stack) if not _is_library(file))
    return next((f" ({Path(file).name}, line {line}, {name})" for file, line, name in calls), "")


def code_digests(names: Iterable[str]) -> dict[str, str]:
    """Return "package.module:Class" → digest of the file of that module, for each of *names* that has one.

    Modules that it imports in turn are not looked at; built-ins and servers have no such file.
    """
    files = {name: _file_of(name.partition(":")[0]) for name in sorted(set(names)) if ":" in name}
    return {name: hashlib.sha256(file.read_bytes()).hexdigest()[:16] for name, file in files.items() if file}


def _file_of(module: str) -> Path | None:
    if module in _SERVERS:
        return None
    loaded = sys.modules.get(module)
    try:
        found = None if loaded else importlib.util.find_spec(module)
    except (ImportError, ValueError, AttributeError):
        return None
    name = getattr(loaded, "__file__", None) or (found and found.origin)
    return Path(name) if name and Path(name).is_file() else None


def _unwrapped(plug_in: object) -> object:
    """Return what is in wrappers of ours, such as a planner with defects: their attribute ``planner`` or ``policy``."""
    code = _code_of_plan(plug_in)
    inner = getattr(plug_in, "planner", getattr(plug_in, "policy", None))
    if inner is None or code is None or not code.co_filename.startswith(_OURS):
        return plug_in
    return _unwrapped(inner)


def _code_of_plan(plug_in: object) -> CodeType | None:
    code = getattr(getattr(type(plug_in), "plan", None), "__code__", None)
    return code if isinstance(code, CodeType) else None


@cache
def _standard_library() -> str:
    return sysconfig.get_path("stdlib")


def _is_library(filename: str) -> bool:
    return filename.startswith((_OURS, _standard_library(), "<")) or not _INSTALLED.isdisjoint(
        Path(filename).parts
    )


def _source_of(kind: type) -> str:
    try:
        return inspect.getsourcefile(kind) or ""
    except (TypeError, OSError):
        return ""
