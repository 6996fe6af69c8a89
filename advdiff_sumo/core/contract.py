"""Shared parts of the contract checks of planners and policies: problems, exceptions, content of values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from advdiff_sumo.core.plug_in_source import described, raised_at
from advdiff_sumo.core.process_end import hears_ctrl_c

#: Levels of nested values that :func:`content_of` looks into.
_MAX_DEPTH = 12
_Situation = TypeVar("_Situation")
_Plan = TypeVar("_Plan")


@dataclass(frozen=True)
class Problem:
    """A violation of the contract by a plug-in, in one sentence.

    Attributes:
        part: part of the contract.
        text: the sentence.
        harmless: whether it is allowed and only reported.
        remedy: what the author can do; "" if the sentence says so.
    """

    part: StrEnum
    text: str
    harmless: bool = False
    remedy: str = ""


def what_it_raised(error: BaseException, plug_in: object) -> str:
    """Return a sentence on what *plug_in* raised, and where; a Ctrl-C by the user is raised again."""
    if isinstance(error, KeyboardInterrupt) and hears_ctrl_c():
        raise error
    return f"it raised {described(error)}{raised_at(error, plug_in)}"


def remembers_situations(
    plan_in: Callable[[_Situation], _Plan],
    situations: Sequence[_Situation],
    same: Callable[[_Plan, _Plan], bool],
) -> bool:
    """Return whether the plan in the first situation changes after plans in all of them have been made.

    False if the plug-in raises; another check reports that.

    Args:
        plan_in: returns the first plan of an episode that begins in a situation.
        situations: at least one.
        same: returns whether two plans are equal.
    """
    try:
        before = plan_in(situations[0])
        for situation in situations:
            plan_in(situation)
        return not same(before, plan_in(situations[0]))
    except BaseException as error:  # reported by the check of that situation
        if isinstance(error, KeyboardInterrupt) and hears_ctrl_c():
            raise
        return False


def content_of(value: Any, opaque: Sequence[object] = (), depth: int = 0) -> object:
    """Return the content of *value* in an immutable form, to be compared with its content later.

    Containers, arrays, random generators, dataclasses and other objects with attributes are examined, a dozen levels
    deep. Values cached by a ``cached_property`` are ignored.

    Args:
        value: any value.
        opaque: objects that are not examined, such as the map.
        depth: level of *value*.
    """
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, np.random.Generator):
        return repr(value.bit_generator.state)
    if isinstance(value, str | bytes | int | float | complex | np.generic | None):
        return (type(value), repr(value))
    if depth > _MAX_DEPTH or any(value is x for x in opaque):
        return type(value)

    def inside(part: Any) -> object:
        return content_of(part, opaque, depth + 1)

    if isinstance(value, Mapping):
        return {repr(inside(key)): inside(part) for key, part in value.items()}
    if isinstance(value, Set):
        return (type(value), tuple(sorted(repr(inside(part)) for part in value)))
    if isinstance(value, Sequence):
        return (type(value), tuple(map(inside, value)))
    return (type(value), tuple((name, inside(part)) for name, part in _attributes(value)))


def only_added_to(before: object, after: object) -> bool:
    """Return whether two contents are equal except for new entries in dictionaries, as caches gain them."""
    if isinstance(before, dict) and isinstance(after, dict):
        return all(key in after and only_added_to(part, after[key]) for key, part in before.items())
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        return all(only_added_to(*pair) for pair in zip(before, after, strict=True))
    return before == after


def _attributes(value: Any) -> list[tuple[str, Any]]:
    """Return the names and values of an object's attributes; [] for classes, functions and modules."""
    if is_dataclass(value) and not isinstance(value, type):
        return [(x.name, getattr(value, x.name, None)) for x in fields(value)]
    if callable(value) or type(value).__name__ == "module":
        return []
    attributes = getattr(value, "__dict__", {})
    cached = (name for name in attributes if isinstance(getattr(type(value), name, None), cached_property))
    return [(name, attributes[name]) for name in sorted(attributes.keys() - set(cached))]
