"""Every command in the pages exists with its options; commands that need nothing else are run.

ADVDIFF_DOCS=all runs the slow ones, too.
"""

from __future__ import annotations

import ast
import gzip
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.sim.demand import write_demand
from advdiff_sumo.sim.sim_options import SceneOptions
from tests.docs.blocks import ROOT, SHELL, Block, blocks, commands, inline_commands, pages, shell_blocks
from tests.docs.known import leaf, options_of, problem
from tests.e2e.warm_start import WarmStart
from tests.hang_guard import HANG_S

MARKS = ("", "skip", "slow", "data", "weights")
EVERYTHING = os.environ.get("ADVDIFF_DOCS") == "all"


def place(block: Block) -> str:
    return f"{block.page}:{block.line}"


@pytest.mark.parametrize("block", shell_blocks(), ids=place)
def test_the_command_exists_with_its_options(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = commands(block.script)
    assert found
    wrong = [f"{shlex.join(words)}: {what}" for words in found if (what := problem(words))]
    assert wrong == []
    assert block.mark in MARKS
    assert block.rest or block.mark not in ("skip", "slow"), "say why it is not run"
    assert [
        named for named in re.findall(r"(?:tests|docs)/[\w./]*\w", block.rest) if not (ROOT / named).exists()
    ] == []


@pytest.mark.parametrize("page", pages())
def test_commands_in_the_text_exist(page: str) -> None:
    for words in inline_commands(page):
        command, rest = leaf(words)
        unknown = {word for word in rest if word.startswith("-")} - options_of(command)
        assert not unknown, shlex.join(words)


@pytest.mark.parametrize("page", pages())
def test_blocks_have_a_known_language(page: str) -> None:
    for block in blocks(page):
        assert block.language in (*SHELL, "python", "toml"), place(block)
        if block.language == "toml":
            tomllib.loads(block.code)
        if block.language == "python":
            for node in ast.walk(ast.parse(block.code)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("advdiff_sumo"):
                    module = importlib.import_module(str(node.module))
                    assert all(hasattr(module, name.name) for name in node.names), place(block)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("advdiff-sumo rnu", "no verb"),
        ("advdiff-sumo run --tarket IDM", "--tarket"),
        ("advdiff-sumo run --target IDN", "IDM"),
        ("advdiff-sumo run --net uptown", "uptown"),
        ("advdiff-sumo run --set sim.control_radius=80", "control_radius_m"),
        ("advdiff-sumo run --episodes many", "valid integer"),
        ("advdiff-sumo figure runs/first", "out"),
        ("advdiff-sumo export runs/first --format cvs", "csv"),
        ("advdiff-sumo train traffic --data w --out o --set epoch=3", "epochs"),
        ("make tset", "no target tset"),
        ("python tools/make_network.py", "no file"),
        ("python tools/render_net.py a.net.xml --path", "no option --path"),
        ("frobnicate", "no program"),
    ],
)
def test_a_stale_command_is_noticed(words: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert what in problem(shlex.split(words))


def test_scripts_are_split_into_commands_as_by_a_shell() -> None:
    script = "A=1 x --a 'b > c' > out  # no\ncat > f <<'END'\ny z\nEND\np \\\n q && r \"s\nt\"\n"
    assert commands(script) == [["x", "--a", "b > c"], ["cat"], ["p", "q"], ["r", "s\nt"]]


class Workshop:
    """A folder like a checkout, in which the commands of pages are run.

    Commands of the README are started as installed; those of other pages from a process that has imported everything.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: set[str] = set()
        for name in ("examples", "scenarios", "tools", "networks"):
            (folder / name).symlink_to(ROOT / name)
        self._write_net_and_demand()
        programs = Path(sys.executable).parent
        self.environment = {
            **os.environ,
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "COLUMNS": "100",
            "NO_COLOR": "1",
        }
        self.warm = WarmStart(self.environment)
        (folder / ".programs").mkdir()
        self.warm.write_program(folder / ".programs")

    def _write_net_and_demand(self) -> None:
        """Write the net that the pages call *my.net.xml*, and a demand for it."""
        net = shutil.copy(ROOT / "networks" / "downtown-left.net.xml", self.folder / "my.net.xml")
        (self.folder / "my.net.xml.gz").write_bytes(gzip.compress(net.read_bytes()))
        road = RoadMap.read(net)
        write_demand(road, SceneOptions(), 600.0, SeedTree(0), self.folder / "my.rou.xml")

    def work_through(self, page: str) -> None:
        """Run the commands of *page* unless they have been run already."""
        if page in self.done:
            return
        self.done.add(page)
        for block in blocks(page):
            if block.mark == "file":
                (self.folder / block.rest).write_text(block.code, encoding="utf-8")
            elif block.language in SHELL and runs(block):
                self.run(block, warm=page != "README.md")

    def run(self, block: Block, *, warm: bool) -> None:
        """Run the commands of *block*; fail at the first error."""
        programs = f"{self.folder / '.programs'}{os.pathsep}" if warm else ""
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block.script],
            cwd=self.folder,
            env={**self.environment, "PATH": f"{programs}{self.environment['PATH']}"},
            pass_fds=[self.warm.descriptor],
            capture_output=True,
            text=True,
            check=False,
            timeout=HANG_S,
        )
        assert done.returncode == 0, f"{place(block)}\n{block.script}{done.stdout}{done.stderr}"


def runs(block: Block) -> bool:
    """Return whether *block* is run in this environment."""
    return {
        "skip": False,
        "slow": EVERYTHING,
        "data": "ADVDIFF_DATA" in os.environ,
        "weights": shipped_weights().is_file(),
        "": True,
    }[block.mark]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workshop]:
    shop = Workshop(tmp_path_factory.mktemp("docs"))
    yield shop
    shop.warm.end()


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in pages() if any(b.language in SHELL and runs(b) for b in blocks(p))]
)
def test_the_page_can_be_worked_through(page: str, workshop: Workshop) -> None:
    workshop.work_through("README.md")  # other pages use its first run
    workshop.work_through(page)
    assert (workshop.folder / "runs" / "first" / "report.html").is_file()
