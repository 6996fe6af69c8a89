"""What the contract checks of planners and of policies share: problems, what is raised, and what values hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from advdiff_sumo.core.plug_in_source import described, raised_at
from advdiff_sumo.core.process_end import hears_ctrl_c

_DEEPEST = 12
_Situation = TypeVar("_Situation")
_Plan = TypeVar("_Plan")


@dataclass(frozen=True)
class Problem:
    """What a plug-in does against a part of its contract, in one sentence.

    Attributes:
        part: of the contract.
        text: the sentence.
        harmless: it may do so, and is told.
        remedy: what its author can do; "" where the sentence says so.
    """

    part: StrEnum
    text: str
    harmless: bool = False
    remedy: str = ""


def what_it_raised(error: BaseException, plug_in: object) -> str:
    """Return a sentence on what *plug_in* raised, and where; Ctrl-C of the user's goes on."""
    if isinstance(error, KeyboardInterrupt) and hears_ctrl_c():
        raise error
    return f"it raised {described(error)}{raised_at(error, plug_in)}"


def remembers_situations(
    plan_in: Callable[[_Situation], _Plan],
    situations: Sequence[_Situation],
    same: Callable[[_Plan, _Plan], bool],
) -> bool:
    """Return whether the plan in the first situation changes once there have been plans in all of them.

    A plug-in that raises is no matter of this check: False.

    Args:
        plan_in: returns the first plan of an episode that begins in a situation.
        situations: one at least.
        same: whether two plans are equal.
    """
    try:
        before = plan_in(situations[0])
        for situation in situations:
            plan_in(situation)
        return not same(before, plan_in(situations[0]))
    except BaseException as error:  # told by the check of that situation
        if isinstance(error, KeyboardInterrupt) and hears_ctrl_c():
            raise
        return False


def content_of(value: Any, opaque: Sequence[object] = (), depth: int = 0) -> object:
    """Return what *value* holds as a thing that stays as it is, to be compared with what it holds later.

    Looks into containers, arrays, random generators, dataclasses and other objects with attributes, a dozen levels
    deep; what a ``cached_property`` has kept is no content.

    Args:
        value: anything.
        opaque: objects that are not looked into, such as the map.
        depth: level of *value*.
    """
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, np.random.Generator):
        return repr(value.bit_generator.state)
    if isinstance(value, str | bytes | int | float | complex | np.generic | None):
        return (type(value), repr(value))
    if depth > _DEEPEST or any(value is one for one in opaque):
        return type(value)

    def inside(part: Any) -> object:
        return content_of(part, opaque, depth + 1)

    if isinstance(value, Mapping):
        return {repr(inside(key)): inside(one) for key, one in value.items()}
    if isinstance(value, Set):
        return (type(value), tuple(sorted(repr(inside(one)) for one in value)))
    if isinstance(value, Sequence):
        return (type(value), tuple(map(inside, value)))
    return (type(value), tuple((name, inside(part)) for name, part in _attributes(value)))


def only_added_to(before: object, after: object) -> bool:
    """Return whether two contents are equal but for entries that tables have gained, as caches do."""
    if isinstance(before, dict) and isinstance(after, dict):
        return all(key in after and only_added_to(part, after[key]) for key, part in before.items())
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        return all(only_added_to(*pair) for pair in zip(before, after, strict=True))
    return before == after


def _attributes(value: Any) -> list[tuple[str, Any]]:
    """Return what an object consists of; nothing of classes, functions and modules."""
    if is_dataclass(value) and not isinstance(value, type):
        return [(one.name, getattr(value, one.name, None)) for one in fields(value)]
    if callable(value) or type(value).__name__ == "module":
        return []
    own = getattr(value, "__dict__", {})
    kept = (name for name in own if isinstance(getattr(type(value), name, None), cached_property))
    return [(name, own[name]) for name in sorted(own.keys() - set(kept))]
