"""Where machine code of kernels is kept: that which ships with the package, and that which was compiled here.

A kernel compiles for half a minute with all that it calls, so nobody should wait for it twice. Code is found by a
digest of all that it follows from: the kernel and whatever it calls, numbers that it reads from its module, types of
its arguments, processor, Python, numba and LLVM. Dates and places of files do not count, so that code outlives a
reinstallation and is right after any change.

The shipped code is for processors of level x86-64-v3 (AVX2 and FMA, most since 2013), and on those nothing else is
compiled for: shipped or compiled here, the same code runs, and plans are the same to the last bit.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from inspect import getsource
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
from llvmlite import binding
from numba.core import config as numba_config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.serialize import dumps

PACKAGE = __name__.partition(".")[0]
#: Set to anything, it keeps shipped code from being used: for those who measure the compiler or make that code.
IGNORE_SHIPPED = "ADVDIFF_COMPILE"
#: Level of processors that code is made for, and what it has beside the level before.
LEVEL = "x86-64-v3"
_NEEDED = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave")
#: What pickle raises of a damaged file.
_DAMAGED = (pickle.UnpicklingError, EOFError, ValueError, KeyError, IndexError, AttributeError, ImportError)
_linked: set[str] = set()


def aim_at_level() -> None:
    """Let numba compile for ``LEVEL`` where the processor has it and nobody asked for another one."""
    config: Any = numba_config  # its names are made when it is loaded
    if platform.machine() not in ("x86_64", "AMD64") or config.CPU_NAME is not None:
        return
    features = binding.get_host_cpu_features()
    if all(features.get(name, False) for name in _NEEDED):
        config.CPU_NAME, config.CPU_FEATURES = LEVEL, ""


def shipped_code() -> Path:
    """Return where the shipped code for this Python and system lies, or would."""
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}-{sys.platform}-{platform.machine()}".lower()
    return Path(str(files(PACKAGE))) / "weights" / f"kernels-{tag}.zip"


def runs_shipped() -> bool:
    """Return whether shipped code is there, wanted, and for what numba compiles for."""
    config: Any = numba_config
    return config.CPU_NAME == LEVEL and not os.environ.get(IGNORE_SHIPPED) and shipped_code().exists()


def own_folder() -> Path:
    """Return the folder for code that was compiled here; it is the user's, not the package's."""
    asked = os.environ.get("NUMBA_CACHE_DIR")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(asked) if asked else Path(base) / "advdiff-sumo" / "kernels"


def link_shipped() -> None:
    """Link the shipped code of all modules that are loaded now, so that no plan waits for it."""
    for name in sorted(_shipped().keys() - _linked):
        module, function, _ = name.split("-")
        if module in sys.modules:
            _linked.add(name)
            signature = pickle.loads(_shipped()[name])[0]  # noqa: S301 - the package's own
            getattr(sys.modules[module], function).compile(signature)


class _Nowhere(_CacheLocator):
    """Stands where numba asks for a place of its own, which ``_Files`` does not use."""

    def get_cache_path(self) -> str:
        return ""

    def get_source_stamp(self) -> None:
        return None

    def get_disambiguator(self) -> str:
        return ""

    def ensure_cache_path(self) -> None:
        return None

    @classmethod
    def from_function(cls, function: FunctionType, path: str) -> _Nowhere:  # noqa: ARG003 - numba's signature
        return cls()


class _Results(CompileResultCacheImpl):
    """How numba writes compiled functions down."""

    _locator_classes = [_Nowhere]  # type: ignore[list-item]  # noqa: RUF012 - numba declares both so


class KernelCache(FunctionCache):
    """numba's cache of one kernel, with files of our own.

    Args:
        function: the kernel's Python.
        how: options of the compiler.
    """

    _impl_class = _Results

    def __init__(self, function: FunctionType, how: dict[str, Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call] # numba's
        self._cache_file: Any = _Files(function, _told(how))


class _Files:
    """Entries of one kernel, one file for each combination of argument types."""

    def __init__(self, function: FunctionType, how: str) -> None:
        self._function, self._how = function, how

    def load(self, key: tuple[Any, ...]) -> Any:
        """Return what was kept for *key* of numba, or None."""
        name = self._name(key)
        data = _shipped().get(name) or _read(own_folder() / name)
        try:
            return None if data is None else pickle.loads(data)[1]  # noqa: S301 - the package's own, or the user's
        except _DAMAGED:
            return None

    def save(self, key: tuple[Any, ...], data: Any) -> None:
        """Keep *data* for *key*, whole or not at all; where the folder cannot be written nothing is kept."""
        path = own_folder() / self._name(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".aside", delete=False) as aside:
                aside.write(dumps((key[0], data)))  # type: ignore[no-untyped-call] # numba's
            Path(aside.name).replace(path)
        except OSError:
            return

    def flush(self) -> None:
        """Do nothing: what does not fit is never found."""

    def _name(self, key: tuple[Any, ...]) -> str:
        signature, machine, _ = key
        parts = fingerprint(self._function), self._how, str(signature), repr(machine), *_versions()
        digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
        return f"{self._function.__module__}-{self._function.__name__}-{digest}"


def fingerprint(function: FunctionType) -> str:
    """Return a digest of *function* and of all that it calls and reads in this package."""
    return hashlib.sha256("\n".join(sorted(_parts(function, set()))).encode()).hexdigest()


def _parts(function: FunctionType, known: set[str]) -> Iterator[str]:
    """Yield texts that say what *function* computes, and what those compute that it calls and are not *known*."""
    where = f"{function.__module__}.{function.__qualname__}"
    if where in known:
        return
    known.add(where)
    code = function.__code__
    numbers = [repr(value) for value in code.co_consts if isinstance(value, int | float | tuple)]
    yield f"{where} {code.co_code.hex()} {code.co_names} {code.co_varnames} {numbers}"
    for name in code.co_names:
        yield from _named(f"{where} {name}", function.__globals__.get(name), known)


def _named(what: str, value: Any, known: set[str]) -> Iterator[str]:
    """Yield texts for a global that is read or called as *what*."""
    inner = getattr(value, "py_func", None)
    if isinstance(inner, FunctionType):
        yield f"{what}: {inner.__qualname__} {_told(value.targetoptions)}"
        yield from _parts(inner, known)
    elif isinstance(value, FunctionType) and value.__module__.startswith(PACKAGE):
        yield getsource(sys.modules[value.__module__])  # has other implementations for the compiler
    elif isinstance(value, type):
        yield f"{what}: {value.__qualname__} {getattr(value, '_fields', ())}"
    elif value is not None and not callable(value) and not isinstance(value, ModuleType):
        yield f"{what} = {value!r}"


def _told(options: dict[str, Any]) -> str:
    """Return options of the compiler as text that is the same in every process; sets have no order."""
    plain = {name: sorted(value) if isinstance(value, set) else value for name, value in options.items()}
    return repr(sorted(plain.items()))


@cache
def _shipped() -> dict[str, bytes]:
    """Return what ships for this Python and system, by name; nothing where there is none or it is not wanted."""
    if os.environ.get(IGNORE_SHIPPED) or not shipped_code().exists():
        return {}
    with zipfile.ZipFile(shipped_code()) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _versions() -> tuple[str, ...]:
    return f"{sys.version_info.major}.{sys.version_info.minor}", numba.__version__, llvmlite.__version__
