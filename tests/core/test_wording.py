"""Parts of sentences: counts and lists."""

from __future__ import annotations

import pytest

from advdiff_sumo.core.wording import counted, in_ranges, in_series


@pytest.mark.parametrize(
    ("count", "noun", "words"),
    [
        (1, "finding", "1 finding"),
        (0, "finding", "0 findings"),
        (1, "critical near miss", "1 critical near miss"),
        (3, "critical near miss", "3 critical near misses"),
    ],
)
def test_the_noun_agrees_with_its_count(count: int, noun: str, words: str) -> None:
    assert counted(count, noun) == words


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["RSS"], "RSS"),
        (["RSS", "FSM"], "RSS and FSM"),
        (("Reg157", "RSS", "FSM"), "Reg157, RSS and FSM"),
    ],
)
def test_words_are_listed_as_a_sentence_lists_them(words: list[str], expected: str) -> None:
    assert in_series(words) == expected


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ([0], "0"),
        ([0, 1], "0 to 1"),
        ([0, 1, 2, 3, 5, 7], "0 to 3, 5 and 7"),
        ([4, 6, 7], "4 and 6 to 7"),
        (range(0, 100, 2), "50 of 0 to 98"),
    ],
)
def test_numbers_are_told_as_ranges(numbers: list[int], expected: str) -> None:
    assert in_ranges(numbers) == expected
