"""The page in a browser: it sorts, and raises no error."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from advdiff_sumo.report import write_report

_CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_PROBE = """<script>
const errors = []; addEventListener("error", (event) => errors.push(event.message));
addEventListener("DOMContentLoaded", () => {
  const order = () => [...document.querySelectorAll("#episodes tbody th")].map((cell) => cell.textContent).join(" ");
  const heading = [...document.querySelectorAll("#episodes th button")].find((b) => b.textContent === "HEADING");
  const seen = [order()];
  for (let k = 0; k < 2; k++) { heading.click(); seen.push(order() + " " + heading.parentElement.ariaSort); }
  document.title = JSON.stringify([seen, errors, document.documentElement.scrollWidth <= innerWidth]);
});
</script>"""


@pytest.mark.skipif(_CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
@pytest.mark.parametrize(
    ("width", "heading", "orders"),
    [
        (1280, "Episode", ["1 0", "0 1 ascending", "1 0 descending"]),
        (
            400,
            "Least TTC (s)",
            ["1 0", "0 1 ascending", "0 1 descending"],
        ),  # episode 1 has none: it stays last
    ],
)
def test_sorts_without_errors(
    two_episodes: Path, tmp_path: Path, width: int, heading: str, orders: list[str]
) -> None:
    html = write_report(two_episodes).read_text(encoding="utf-8")
    probed = tmp_path / "probed.html"
    probed.write_text(html.replace("<head>", "<head>" + _PROBE.replace("HEADING", heading)), encoding="utf-8")
    command = [str(_CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", probed.as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    found = re.search(r"<title>(.*?)</title>", dom)
    assert found is not None
    expected = ",".join(f'"{order}"' for order in orders)
    assert found.group(1) == f"[[{expected}],[],true]"
