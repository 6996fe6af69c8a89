"""Reads pickles of plain containers and NumPy arrays without executing code from them.

A pickle can name any function and have it called. Here only the names that arrays need are admitted. Each is replaced
by a small class of this module that copies the numbers. NumPy's own unpickling, which trusts its input, is never used.
Containers are returned as dict, list, tuple or set; ``defaultdict`` becomes dict.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from advdiff_sumo.core.errors import LogError, os_reason
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, GZIP_PROBLEM, unpacked

_KINDS = "biufSU"  # admitted kinds of dtype: bool, int, unsigned, float, bytes, text; never objects
_AGAIN = "copy or convert the record again"
_BROKEN = (
    EOFError,
    AttributeError,
    ImportError,
    IndexError,
    KeyError,
    MemoryError,
    OverflowError,
    RecursionError,
    TypeError,
    UnicodeDecodeError,
    ValueError,
)


def load_plain(path: Path) -> Any:
    """Return the value in the pickle at *path*.

    Raises:
        LogError: the file is missing or truncated, or contains anything other than plain containers and arrays.
    """
    try:
        return _plain(_Restricted(io.BytesIO(_content(path))).load(), {})
    except pickle.UnpicklingError as error:
        if "truncated" in str(error):
            raise LogError(path, "is truncated", _AGAIN) from None
        raise LogError(path, f"refused: {error}", "only records of plain data are read") from None
    except _BROKEN as error:
        problem = f"is truncated or no pickle of plain data ({type(error).__name__}: {error})"
        raise LogError(path, problem, _AGAIN) from None


def _content(path: Path) -> bytes:
    try:
        with unpacked(path) as file:
            return file.read()
    except DAMAGED_GZIP:
        raise LogError(path, GZIP_PROBLEM, _AGAIN) from None
    except OSError as error:
        raise LogError(path, f"cannot be read ({os_reason(error)})", "give a ScenarioNet record") from None


class _Dtype:
    """Replaces ``numpy.dtype`` in a pickle."""

    __slots__ = ("code", "order")

    def __init__(self, code: str, *flags: object) -> None:  # noqa: ARG002 - align and copy do not matter
        self.code, self.order = code, "="

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Set the byte order; sub-arrays, fields and metadata are refused."""
        if any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError("it holds a structured array")
        self.order = {"|": "=", "<": "<", ">": ">", "=": "="}[state[1]]

    def numpy(self) -> np.dtype[Any]:
        """Return the dtype; refuse kinds that are not plain."""
        dtype = np.dtype(str(self.code))
        if dtype.kind not in _KINDS:
            raise pickle.UnpicklingError(f"it holds an array of {dtype}")
        return dtype.newbyteorder(self.order)  # type: ignore[arg-type]  # checked in __setstate__


class _Array:
    """Replaces an array while its pickle is read (``numpy.core.multiarray._reconstruct``)."""

    __slots__ = ("value",)

    def __init__(self, *ignored: object) -> None:  # noqa: ARG002 - NumPy's placeholder shape
        self.value: NDArray[Any] | None = None

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Copy the array from its shape, dtype, order and raw bytes."""
        _, shape, dtype, fortran, raw = state
        self.value = _copied(raw, dtype, shape, "F" if fortran else "C")


class _Buffered(_Array):
    """Replaces ``numpy.core.numeric._frombuffer``, an array in pickle protocol 5."""

    __slots__ = ()

    def __init__(self, raw: object, dtype: object, shape: tuple[int, ...], order: object) -> None:
        super().__init__()
        self.value = _copied(raw, dtype, shape, "F" if order == "F" else "C")


class _Scalar:
    """Replaces a NumPy scalar (``numpy.core.multiarray.scalar``)."""

    __slots__ = ("value",)

    def __init__(self, dtype: object, raw: object) -> None:
        self.value = _copied(raw, dtype, (1,), "C")[0].item()


def _copied(raw: object, dtype: object, shape: tuple[int, ...], order: Literal["C", "F"]) -> NDArray[Any]:
    if not isinstance(dtype, _Dtype) or not isinstance(raw, bytes | bytearray):
        raise pickle.UnpicklingError("it holds an array of objects")
    flat: NDArray[Any] = np.frombuffer(raw, dtype=dtype.numpy())
    return flat.reshape(tuple(int(n) for n in shape), order=order).copy()


class _Mapping(dict[Any, Any]):
    """Replaces ``collections.defaultdict`` and ``OrderedDict``; ignores the factory."""

    __slots__ = ()

    def __init__(self, *factory: object) -> None:  # noqa: ARG002 - ignored
        super().__init__()


class _Marker:
    """Replaces a type that a pickle may name but not call: an array's class, a defaultdict's factory."""

    __slots__ = ()

    def __init__(self, *ignored: object) -> None:  # noqa: ARG002 - whatever it is called with
        raise pickle.UnpicklingError("it calls a type that may only be named")

    def __setstate__(self, state: object) -> None:
        """Refuse."""
        raise pickle.UnpicklingError("it sets the state of a type that may only be named")


_ADMITTED: dict[tuple[str, str], type] = {
    ("numpy", "ndarray"): _Marker,
    ("numpy", "dtype"): _Dtype,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _Array for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _Scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _Buffered for core in ("core", "_core")},
    ("collections", "defaultdict"): _Mapping,
    ("collections", "OrderedDict"): _Mapping,
    **{("builtins", name): _Marker for name in ("int", "float", "str", "bool", "list", "dict", "set")},
}


class _Restricted(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return the replacement class of an admitted name; refuse all others."""
        admitted = _ADMITTED.get((module, name))
        if admitted is None:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return type(admitted.__name__, (admitted,), {"__slots__": (), "__setstate__": _state_of(admitted)})

    def persistent_load(self, pid: Any) -> Any:
        """Refuse references to data outside the pickle."""
        raise pickle.UnpicklingError(f"it refers to outside data {pid!r}")


def _state_of(kind: type) -> Any:
    """Return the ``__setstate__`` of *kind*, or one that refuses."""
    set_state = getattr(kind, "__setstate__", None)
    return set_state if set_state is not None else _no_state


def _no_state(self: object, state: object) -> None:  # noqa: ARG001 - the protocol of pickle
    raise pickle.UnpicklingError("it sets the state of a plain container")


def _plain(value: Any, done: dict[int, Any]) -> Any:
    """Return *value* with all replacement objects converted.

    *done* maps the identity of each converted object to its result, so that shared objects remain shared.
    """
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    if id(value) in done:
        if done[id(value)] is _IN_PROGRESS:
            raise pickle.UnpicklingError("a container holds itself")
        return done[id(value)]
    done[id(value)] = _IN_PROGRESS
    done[id(value)] = result = _converted(value, done)
    return result


_IN_PROGRESS = object()


def _converted(value: Any, done: dict[int, Any]) -> Any:
    if isinstance(value, dict):
        return {_plain(k, done): _plain(v, done) for k, v in value.items()}
    for kind in (list, tuple, set, frozenset):
        if isinstance(value, kind):
            return kind(_plain(item, done) for item in value)
    if isinstance(value, _Array | _Scalar):
        if value.value is None:
            raise pickle.UnpicklingError("it holds an array without data")
        return value.value
    raise pickle.UnpicklingError(f"it holds a {type(value).__name__}")
