"""``python -m advdiff_sumo.planner_kit`` refuses what it cannot serve in one sentence, with file and line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from advdiff_sumo.planner_kit import serve
from advdiff_sumo.planner_kit.__main__ import main

_PLANNERS = """
class Sound:
    def __init__(self, gain):
        self.gain = 1.0 / gain

    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        return None


class NoPlan:
    def start(self, road, scene, rng):
        return None


class OtherPlan(NoPlan):
    def plan(self, scene):
        return None
"""


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["kit_open:A"], r"planner 'kit_open:A' cannot be made: SyntaxError: .* \(kit_open\.py, line 1\)"),
        (
            ["kit_leaves:A"],
            r"planner 'kit_leaves:A' cannot be made: SystemExit: 4 \(kit_leaves\.py, line 2, <module>\)",
        ),
        (["kit_mine:Sound"], r"planner 'kit_mine:Sound' cannot be made: TypeError: .* missing 1 .* 'gain'"),
        (
            ["kit_mine:Sound", "--options", json.dumps({"gain": 0})],
            r"planner 'kit_mine:Sound' cannot be made: ZeroDivisionError: .* \(kit_mine\.py, line 4, __init__\)",
        ),
        (["kit_mine:Missing"], "planner 'kit_mine:Missing' cannot be made: .* no attribute 'Missing'"),
        (["kit_mine:NoPlan"], "planner 'kit_mine:NoPlan' lacks plan"),
        (
            ["kit_mine:OtherPlan", "--address", "localhost:99999"],
            "planner 'kit_mine:OtherPlan' cannot be used: plan is called with road, scene, memory, rng, and cannot",
        ),
        (
            ["kit_mine:Sound", "--options", "[1]"],
            r"--options \[1\]: it is no object; give a JSON object, such as",
        ),
        (["kit_mine:Sound", "--options", "{a"], r"--options {a: Expecting .*; give a JSON object, such as"),
        (
            ["kit_mine:Sound", "--options", json.dumps({"gain": 1}), "--read-road", "kit_mine:Map"],
            "--read-road kit_mine:Map cannot be made: .* no attribute 'Map'",
        ),
        (
            [
                "kit_mine:Sound",
                "--options",
                json.dumps({"gain": 1}),
                "--address",
                "unix:missing/folder/socket",
            ],
            "cannot listen at unix:missing/folder/socket: it is in use, or .* machine; choose another --address",
        ),
        (
            ["kit_mine:Sound", "--options", json.dumps({"gain": 1}), "--address", "localhost:99999"],
            "no port 99999: the largest is 65535; choose another --address",
        ),
    ],
)
def test_what_cannot_be_served_is_refused_in_one_sentence(
    words: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    files = {"kit_open": "class A(:\n", "kit_leaves": "import sys\nsys.exit(4)\n", "kit_mine": _PLANNERS}
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("sys.argv", ["planner_kit", *words])

    with pytest.raises(SystemExit) as end:
        main()

    assert end.value.code == 2
    last_line = capfd.readouterr().err.splitlines()[-1]
    prefix, _, said = last_line.partition(": error: ")
    assert prefix == "python -m advdiff_sumo.planner_kit"
    assert re.match(sentence, said)


@pytest.mark.parametrize("not_a_planner", [lambda: None, None, json])
def test_what_is_no_planner_is_not_served(not_a_planner: object) -> None:
    kind = type(not_a_planner).__name__
    with pytest.raises(
        TypeError, match=rf"^{kind} lacks start and plan; give serve\(\) a planner, or its class$"
    ):
        serve(not_a_planner, "localhost:99999")
