"""Options are strict and frozen, and misspelt names get suggestions; reading of TOML files; ``--set``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from advdiff_sumo.config import Options, read_toml, set_dotted
from advdiff_sumo.core.errors import ConfigError, FileError, InputError
from advdiff_sumo.sim.sim_options import SimOptions


class Inner(Options):
    step_s: float = Field(0.1, gt=0.0)
    name: str = "x"


class Outer(Options):
    inner: Inner = Inner()
    count: int = 1
    must: int = 0
    seeds: tuple[int, ...] = ()


class Needy(Options):
    wanted: int


def test_given_values_replace_defaults() -> None:
    options = Outer.parse({"inner": {"step_s": 0.2}, "count": 3})
    assert (options.inner.step_s, options.inner.name, options.count) == (0.2, "x", 3)


def test_options_are_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Outer().count = 2  # type: ignore[misc] # that is the test


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"cuont": 1}, "run.toml: no option 'cuont'; did you mean 'count'?"),
        ({"inner": {"stepS": 1}}, "run.toml: no option 'inner.stepS'; did you mean 'step_s'?"),
        ({"inner": {"step-s": 1}}, "run.toml: no option 'inner.step-s'; did you mean 'step_s'?"),
        ({"zzz": 1}, "run.toml: no option 'zzz'; known are: count, inner, must, seeds"),
        ({"inner": {"step_s": -1.0}}, "run.toml: inner.step_s = -1.0: input should be greater than 0"),
        (
            {"inner": {"step_s": float("nan")}},
            "run.toml: inner.step_s = nan: input should be a finite number",
        ),
        ({"count": "many"}, "run.toml: count = 'many': input should be a valid integer"),
        (
            {"inner": 3},
            "run.toml: inner = 3: that is a group of options; set one of them, such as inner.step_s",
        ),
        ({"seeds": 3}, "run.toml: seeds = 3: give a list, such as [3]"),
        ({"seeds": {"a": 1}}, "run.toml: seeds = {...}: give a list, such as [{...}]"),
        ({"step_s": 1}, "run.toml: no option 'step_s'; did you mean 'inner.step_s'?"),
        ({"inner": {"count": 1}}, "run.toml: no option 'inner.count'; did you mean 'count'?"),
        ({"inner.step_s": 1}, "run.toml: no option 'inner.step_s'; write it without quotation marks"),
    ],
)
def test_a_wrong_option_gets_one_sentence(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Outer.parse(values, "run.toml")
    assert str(caught.value).startswith(sentence)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, InputError)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (
            {"model_step_s": 0.55, "history_s": 2.0, "release_factor": 1.5},
            "options: model_step_s = 0.55 is no whole multiple of 0.1",
        ),
        ({"step_s": {"a": 1, "b": [2] * 90}}, "options: step_s = {...}: input should be a valid number"),
        ({"step_s": [7] * 90}, "options: step_s = [7, 7, 7, 7, ...]: input should be a valid number"),
    ],
)
def test_long_values_are_not_echoed(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        SimOptions.parse(values)
    assert str(caught.value) == sentence


def test_a_rule_about_a_group_names_the_group() -> None:
    class Whole(Options):
        sim: SimOptions = SimOptions()

    with pytest.raises(ConfigError) as caught:
        Whole.parse({"sim": {"model_step_s": 0.55, "release_factor": 1.5}})
    assert str(caught.value) == "options: sim: model_step_s = 0.55 is no whole multiple of 0.1"


def test_a_missing_option_is_named() -> None:
    with pytest.raises(ConfigError, match=r"options: option 'wanted' is missing"):
        Needy.parse({})


def test_the_message_of_a_models_own_rule_is_shown() -> None:
    with pytest.raises(ConfigError, match=r"model_step_s = 0\.55 is no whole multiple of 0\.1"):
        SimOptions.parse({"model_step_s": 0.55})


def test_dotted_assignments() -> None:
    values: dict[str, Any] = {"sim": {"step_s": 0.1}}
    for text in (
        "sim.step_s=0.2",
        "target.options.tau = 1.5",
        "name=IDM",
        "flag=true",
        "list=[1, 2]",
        'q="3"',
        "e=a=b",
    ):
        set_dotted(values, text)
    assert values == {
        "sim": {"step_s": 0.2},
        "target": {"options": {"tau": 1.5}},
        "name": "IDM",
        "flag": True,
        "list": [1, 2],
        "q": "3",
        "e": "a=b",
    }


@pytest.mark.parametrize("text", ["sim.step_s", "=3", " =3", ""])
def test_an_assignment_without_name_or_sign_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"expected NAME=VALUE, for example --set sim\.step_s=0\.1"):
        set_dotted({}, text)


def test_an_assignment_below_a_value_is_refused() -> None:
    with pytest.raises(ConfigError, match="'step_s' is not a group of options"):
        set_dotted({"sim": {"step_s": 0.1}}, "sim.step_s.more=1")


def test_toml_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("[sim]\nstep_s = 0.1\n")
    assert read_toml(path) == {"sim": {"step_s": 0.1}}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (
            b"[sim\nstep_s = 1",
            "not valid TOML (Expected ']' at the end of a table declaration (at line 1, column 5))",
        ),
        (b"a = 1\na = 2\n", "line 2"),
        (b"\xff\xfe", "not valid TOML"),
    ],
)
def test_toml_that_cannot_be_read_names_file_and_place(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    path = tmp_path / "bad.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert caught.value.path == path


def test_toml_of_other_editors(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes("\ufeffnet = 'a'\r\n".encode())
    assert read_toml(path) == {"net": "a"}
    path.write_bytes("net = 'a'".encode("utf-16"))
    with pytest.raises(FileError, match="not valid TOML: it is not text in UTF-8; save it as UTF-8"):
        read_toml(path)


def test_a_folder_is_no_toml_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be read"):
        read_toml(tmp_path)
