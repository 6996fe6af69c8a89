"""Pages agree with the code, and the targets of links exist."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.sim.run_store import TABLES

ROOT = Path(__file__).resolve().parents[1]


def tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_columns_is_up_to_date(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["write_outputs_doc.py", "--check"])
    assert tool("write_outputs_doc").main() == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "right", "wrong", "complaint", "options"),
    [
        ("write_outputs_doc", "| `step` |", "| `instant` |", "is behind the code", ()),
        (
            "write_results",
            "6.60 [6.13, 7.08]",
            "6.06 [6.13, 7.08]",
            "is behind the benches",
            ("--from", "."),
        ),
    ],
)
def test_a_stale_page_is_noticed_and_mended(
    name: str,
    right: str,
    wrong: str,
    complaint: str,
    options: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    module = tool(name)
    kept, page = module.PAGE.read_text(), tmp_path / module.PAGE.name
    page.write_text(kept.replace(right, wrong))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "PAGE", page)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--check", *options])
    assert module.main() == 1
    assert complaint in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *options])
    assert module.main() == 0
    assert page.read_text() == kept


def test_a_page_without_a_place_for_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="places for"):
        tool("write_outputs_doc").filled("<!-- columns of episodes -->\n<!-- end -->")


def test_words_of_the_tables_are_explained() -> None:
    page = (ROOT / "docs" / "outputs.md").read_text()
    for table in TABLES:
        assert f"| `{table}.parquet` |" in page
    for word in (*EndReason, *(kind.kind for kind in EpisodeFailure.__subclasses__())):
        assert f"`{word}`" in page


def test_every_link_leads_somewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")]
    assert pages
    assert [line for page in pages for line in tool("check_links").broken(page)] == []


def test_the_page_on_the_code_shows_the_import_order() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(x["layers"] for x in contracts if x["name"] == "Imports go one way")
    arrow = " → ".join(layers).replace("advdiff_sumo.", "").replace(" | ", ", ")
    assert f"\n{arrow}\n" in (ROOT / "docs" / "code.md").read_text().replace("→\n", "→ ")


def test_the_changelog_knows_this_version() -> None:
    from advdiff_sumo import __version__

    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "Unreleased"
    assert __version__ in (ROOT / "pyproject.toml").read_text()


def test_the_page_of_defects_is_that_of_the_code_and_the_tables(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(ROOT / "tools")  # since it imports write_results.py
    monkeypatch.setattr(sys, "argv", ["write_defects_doc.py", "--check"])
    assert tool("write_defects_doc").main() == 0, capsys.readouterr().out


def test_the_results_show_the_figures_of_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["write_results.py", "--check", "--from", str(tmp_path)])
    assert tool("write_results").main() == 0, capsys.readouterr().out


def test_the_results_stay_short() -> None:
    page = (ROOT / "docs" / "results.md").read_text()
    assert len(page.encode()) <= 8192
    for table in re.findall(r"^\|.*\n\|-.*\n((?:\|.*\n)+)", page, re.MULTILINE):
        rows = table.splitlines()
        assert len(rows) <= 6
        assert all(row.count("|") - 1 <= 5 for row in rows)


def test_no_page_tells_its_own_history() -> None:
    history = re.compile(
        r"before today|earlier revision|the Q before|as it was (?:before|in)|the default before", re.I
    )
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md")):
        assert not history.findall(page.read_text()), page.name
