"""Words in a row."""

import pytest

from advdiff_sumo.core.wording import in_series


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
