"""Changes of a value's content are detected, and cached values do not belong to the content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.contract import content_of, only_added_to


@dataclass
class Notes:
    seen: dict[str, list[int]] = field(default_factory=lambda: {"a": [1, 2]})
    names: set[str] = field(default_factory=lambda: {"x", "y"})
    places: np.ndarray = field(default_factory=lambda: np.array([np.nan, 1.0]))
    chance: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    count: Any = field(default_factory=lambda: np.int64(3))

    @cached_property
    def total(self) -> float:
        return float(np.nansum(self.places))


def _append(notes: Notes) -> None:
    notes.seen["a"].append(3)


def _name(notes: Notes) -> None:
    notes.names.add("z")


def _place(notes: Notes) -> None:
    notes.places[1] = 2.0


def _draw(notes: Notes) -> None:
    notes.chance.random()


def _count(notes: Notes) -> None:
    notes.count += 1


def _lose(notes: Notes) -> None:
    del notes.seen["a"]


@pytest.mark.parametrize("change", [_append, _name, _place, _draw, _count, _lose])
def test_a_change_is_seen(change: Callable[[Notes], None]) -> None:
    notes = Notes()
    before = content_of(notes)
    assert content_of(notes) == before == content_of(Notes())
    change(notes)
    assert content_of(notes) != before
    assert not only_added_to(before, content_of(notes))


def test_a_new_entry_of_a_table_is_an_addition() -> None:
    notes = Notes()
    before = content_of(notes)
    notes.seen["b"] = []
    assert content_of(notes) != before
    assert only_added_to(before, content_of(notes))
    assert not only_added_to(content_of(notes), before)


def test_cached_and_opaque_values_are_no_content() -> None:
    notes = Notes()
    before, hidden = content_of(notes), content_of([notes], opaque=(notes,))
    assert notes.total == 1.0
    assert content_of(notes) == before
    _count(notes)
    assert content_of([notes], opaque=(notes,)) == hidden


def test_a_cyclic_value_is_handled() -> None:
    circle: list[Any] = []
    circle.append(circle)
    assert content_of(circle) == content_of(circle)
