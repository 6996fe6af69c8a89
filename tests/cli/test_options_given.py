"""Options of a file are overridden by those of the command line and ``--set``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.cli.run import options_given
from advdiff_sumo.core.errors import ConfigError


def given(
    place: Path, content: str, policy: dict[str, Any], *assign: str, defects: list[str] | None = None
) -> Any:
    """Return the options given by a file with *content* and a command line."""
    path = place / "c.toml"
    path.write_text(content)
    return options_given(path, {}, policy, [*assign], defects)


def test_options_of_the_command_are_added_to_the_tables_of_the_file(tmp_path: Path) -> None:
    file = "[target_options]\ntau = 1.5\n[background_options]\nstrength = 0.5\nattack = 'cut-in'\n"
    options = given(
        tmp_path, file, {"strength": 1.0, "guide": None}, "target_options.accel=2", defects=["late"]
    )
    assert options.background_options == {"strength": 1.0, "attack": "cut-in"}
    assert options.target_options == {"tau": 1.5, "accel": 2, "defects": ["late"]}


@pytest.mark.parametrize(
    ("content", "policy", "defects"),
    [
        ("background_options = 3", {"strength": 1.0}, None),
        ("background_options = [1]", {"strength": 1.0}, None),
        ("target_options = 'x'", {}, ["late"]),
    ],
)
def test_a_plain_value_instead_of_a_table_gets_one_sentence(
    tmp_path: Path, content: str, policy: dict[str, Any], defects: list[str] | None
) -> None:
    name, _, value = content.partition(" = ")
    with pytest.raises(ConfigError) as caught:
        given(tmp_path, content, policy, defects=defects)
    assert str(caught.value).endswith(f"c.toml: {name} = {value}: input should be a valid dictionary")


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("target_options.x=nan", "target_options: x = nan: give finite numbers"),
        ("background_options.a.b=[1, 2.5, -inf]", "background_options: a = {...}: give finite numbers"),
        ("target_options.x=[[0.0], [nan]]", "target_options: x = [[0.0], [nan]]: give finite numbers"),
    ],
)
def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, assignment: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        given(tmp_path, "", {}, assignment)
    assert str(caught.value).endswith(f"c.toml: {words}")
    assert given(tmp_path, "", {}, "target_options.x=[1, 2.5, 'nan']").target_options["x"][2] == "nan"
