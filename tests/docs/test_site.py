"""The site is complete, and loads nothing from other servers; it is built once for all tests."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import ROOT
from tests.hang_guard import HANG_S

pytestmark = pytest.mark.slow

MKDOCS = Path(sys.executable).parent / "mkdocs"
_LOADED = re.compile(r"<(?:script|img|iframe)[^>]*\ssrc=\"?([^\"\s>]+)|<link[^>]*\shref=\"?([^\"\s>]+)")
_STYLED = re.compile(r"(?:url\(|@import\s+)[\"']?(https?:|//)")
_TEXT = re.compile(r"<(p|li)>(.*?)</\1>", re.DOTALL)


def build(folder: Path, *, config: Path = ROOT / "mkdocs.yml") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            str(MKDOCS),
            "build",
            "--strict",
            "--config-file",
            str(config),
            "--site-dir",
            str(folder),
        ],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr
    return folder


def articles(site: Path) -> dict[str, str]:
    found = {}
    for path in sorted(site.rglob("*.html")):
        if path.name != "404.html":
            text = path.read_text(encoding="utf-8")
            found[str(path.relative_to(site))] = text[text.find("<article") : text.find("</article>")]
    return found


def test_every_page_is_there(site: Path) -> None:
    written = {
        str(path.relative_to(ROOT / "docs").with_suffix(".html")) for path in ROOT.glob("docs/**/*.md")
    }
    assert set(articles(site)) == written


def test_nothing_is_loaded_from_outside(site: Path) -> None:
    for page in site.rglob("*.html"):
        for found in _LOADED.findall(page.read_text(encoding="utf-8")):
            assert not re.match(r"https?:|//", found[0] or found[1]), f"{page}: {found}"
    for style in site.rglob("*.css"):
        assert not _STYLED.search(style.read_text(encoding="utf-8")), style


def test_lists_and_tables_are_lists_and_tables(site: Path) -> None:
    """The site's Markdown needs a blank line before a list; code-hosting sites do not, so errors are easily missed."""
    for page, article in articles(site).items():
        for _, inner in _TEXT.findall(re.sub(r"<pre.*?</pre>|<code.*?</code>", "", article, flags=re.DOTALL)):
            text = unescape(re.sub(r"<[^>]+>", "", inner))
            assert not re.search(r"\n\s*(?:- |\d+\. |\|)", text), f"{page}: {text[:200]}"


def test_search_finds_pages_and_the_api(site: Path) -> None:
    entries = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    places = {entry["location"] for entry in entries}
    assert "tour.html" in places
    assert "api/maps.html#advdiff_sumo.maps.roadmap.RoadMap.locate" in places
    assert any("teleports" in entry["text"] for entry in entries if entry["location"].startswith("maps.html"))


def test_the_api_has_every_public_class_and_no_roles(site: Path) -> None:
    api = " ".join(text for page, text in articles(site).items() if page.startswith("api/"))
    anchors = set(re.findall(r"id=\"?(advdiff_sumo[\w.]*)", api))
    for name in (
        "core.scene.Scene",
        "planners.planner_protocol.Planner",
        "traffic.policy_protocol.TrafficPolicy",
        "sim.run_episodes.RunOptions",
    ):
        assert f"advdiff_sumo.{name}" in anchors
    assert not re.search(r":(?:class|func|meth|attr|data|mod):", api)


def test_a_broken_link_stops_the_build(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# Page\n\n[there](index.md#nowhere)\n")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    head, _, _ = text.partition("nav:\n  - Start")
    config = tmp_path / "mkdocs.yml"
    config.write_text(head.replace("extensions: [tools/docstring_roles.py]", "extensions: []"))
    done = build(tmp_path / "site", config=config)
    assert done.returncode != 0
    assert "nowhere" in done.stderr


@pytest.mark.parametrize("width", [1360, 420])
def test_it_opens_from_the_disk_and_searches_offline(site: Path, width: int) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    problems: list[str] = []

    def check_request(request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            problems.append(request.url)

    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_context(viewport={"width": width, "height": 900}, offline=True).new_page()
        page.on("request", check_request)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto((site / "index.html").as_uri())
        page.keyboard.press("/")
        page.keyboard.type("encroachment")
        page.wait_for_selector(".md-search-result__item a", timeout=1e3 * HANG_S)
        found = page.locator(".md-search-result__item a").first.get_attribute("href")
        browser.close()
    assert "encroachment" in found or "metrics" in found
    assert problems == []
