"""Help texts and the version of the commands."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from advdiff_sumo import __version__
from tests.e2e.commands import MODULE, advdiff

SCRIPT = Path(sys.executable).parent / "advdiff-sumo"


def test_version_of_the_console_script(tmp_path: Path) -> None:
    done = advdiff("--version", cwd=tmp_path, program=(str(SCRIPT),))
    assert (done.code, done.out, done.err) == (0, f"advdiff-sumo {__version__}\n", "")


def test_a_help_text_needs_no_library_of_numbers_or_simulator() -> None:
    heavy = "{'numpy', 'torch', 'scipy', 'shapely', 'pyarrow', 'matplotlib', 'libsumo'}"
    code = f"import sys, advdiff_sumo.cli.main\nprint({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


@pytest.mark.parametrize("verb", ["run", "sweep", "convert", "margin"])
def test_nothing_is_cut_off_in_eighty_columns(
    tmp_path: Path, verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    said = subprocess.run(
        [*MODULE, verb, "--help"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    words = said.replace("│", " ").split()
    assert [word for word in words if word.endswith("…") and word not in ("…", "scene.…", "sim.…")] == []
    lines = [line.strip() for line in said.split("╭")[0].splitlines()]
    for line, after in pairwise(lines):  # within a paragraph, a line ends only if the next word does not fit
        assert not (line and after) or len(line) + 1 + len(after.split()[0]) > 78


def test_verbs_are_listed(tmp_path: Path) -> None:
    done = advdiff("--help", cwd=tmp_path)
    assert done.code == 0
    for verb in ("run", "convert", "sweep", "results", "compare", "replay"):
        assert f" {verb} " in done.out


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        (
            "run",
            (
                "default: (10)",
                "default: (20)",
                "default: (downtown)",
                "lane_graph",
                "replay",
                "--resume",
                "run.toml",
            ),
        ),
        (
            "sweep",
            ("--resume", "--fail-if", "default: process", "default: (one a core)", "runs what is missing"),
        ),
        (
            "convert",
            ("default: by the map's name", "default: no-report", "ScenarioNet", "--all", "--dataroot"),
        ),
    ],
)
def test_help_teaches(tmp_path: Path, verb: str, words: tuple[str, ...]) -> None:
    done = advdiff(verb, "--help", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    text = " ".join(done.out.replace("│", " ").split())
    for word in words:
        assert word in text, word
    assert (
        len([start for start in text.split(f"advdiff-sumo {verb} ")[1:] if start[0] != "["]) > 0
    )  # an example
    assert list(tmp_path.iterdir()) == []
