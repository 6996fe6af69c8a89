"""Size and speed of a large report: bench_report.py [--run FOLDER] [--episodes 200] [--vehicles 100].

The episodes of a real run are multiplied, and each filled up with copies of its own vehicles; then the page is opened
in Debian's Chromium, without a graphics card.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import tomli_w

from advdiff_sumo.report.page import write_report
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.run_store import TABLES
from advdiff_sumo.sweep.executors import SerialExecutor
from advdiff_sumo.sweep.run_engine import run_into
from advdiff_sumo.sweep.run_folder import RunFolder

_PLAY = """async ([from, seconds]) => {
  const { player } = document.getElementById("player"), gaps = [], spent = [];
  player.speedPart.value = "1"; player.seek(from); player.toggle();
  const end = performance.now() + 1000 * seconds;
  for (let last = performance.now(); last < end && player.playing;) {
    const now = await new Promise(requestAnimationFrame);
    gaps.push(now - last); last = now;
  }
  player.pause();
  for (let k = 0; k < 100; k++) {
    const begun = performance.now(); player.seek(player.episode.end * k / 100);
    player.canvasPart.getContext("2d").getImageData(0, 0, 1, 1); spent.push(performance.now() - begun);
  }
  return [gaps, spent];
}"""


def small_run(folder: Path) -> Path:
    """Make a run of four guided episodes and return its folder."""
    values = {"target": "lane_graph", "background": "diffusion", "episodes": 4, "horizon_s": 20.0}
    run = Run.prepare(RunOptions.parse(values | {"sim": {"stop_at_collision": False}}))
    run_into(run, RunFolder.create(folder, run.settings, resume=False), SerialExecutor(), lambda *_: None)
    return folder


def multiplied(source: Path, folder: Path, episodes: int, vehicles: int) -> Path:
    """Write the tables of *source*, its episodes repeated up to *episodes*, each with at least *vehicles*."""
    folder.mkdir(parents=True)
    whole = {name: pq.read_table(source / f"{name}.parquet") for name in TABLES}
    numbers = whole["episodes"]["episode"].to_pylist()
    parts: dict[str, list[pa.Table]] = {name: [] for name in TABLES}
    for number in range(episodes):
        for name, table in whole.items():
            part = table.filter(pc.equal(table["episode"], numbers[number % len(numbers)]))
            if name == "states":
                part = _crowded(part, vehicles)
            at = part.column_names.index("episode")
            parts[name].append(part.set_column(at, "episode", pa.array(np.full(part.num_rows, number))))
    for name, tables in parts.items():
        pq.write_table(pa.concat_tables(tables), folder / f"{name}.parquet", compression="zstd")
    settings = source / "run.toml"
    if settings.exists():
        shutil.copy(settings, folder)
    else:
        _as_run(folder)
    return folder


def _as_run(folder: Path) -> None:
    options = {"net": "downtown", "target": "lane_graph", "background": "diffusion"}
    (folder / "run.toml").write_text(tomli_w.dumps({"options": options}), encoding="utf-8")


def _crowded(states: pa.Table, vehicles: int) -> pa.Table:
    """Add copies of all vehicles but the target, moved by some metres each, until there are enough."""
    others = states.filter(pc.invert(states["is_target"]))
    copies, have, copy = [states], len(pc.unique(states["agent"])), 0
    each = max(1, have - 1)
    while have < vehicles and others.num_rows:
        copy += 1
        moved = others
        for name, by in (("x_m", 3.1 * copy), ("y_m", -2.3 * copy)):
            moved = moved.set_column(moved.column_names.index(name), name, pc.add(others[name], by))
        names = pc.binary_join_element_wise(others["agent"], f"c{copy}", "-")
        copies.append(moved.set_column(moved.column_names.index("agent"), "agent", names))
        have += each
    return pa.concat_tables(copies)


def opened(page_file: Path, program: str) -> dict[str, Any]:
    """Return load time in s, frame gaps and draw times in ms of *page_file*."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_context(viewport={"width": 1360, "height": 900}, offline=True).new_page()
        begun = time.perf_counter()
        page.goto(page_file.as_uri())
        page.wait_for_selector("#player[data-episode]", timeout=120_000)
        load = time.perf_counter() - begun
        vehicles = page.evaluate("document.getElementById('player').player.episode.agents.length")
        gaps, spent = page.evaluate(_PLAY, [0.0, 8.0])
        browser.close()
    return {"load_s": load, "vehicles": vehicles, "gaps_ms": gaps[1:], "draws_ms": spent}


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, help="folder of a run or sweep; a small guided run otherwise")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--vehicles", type=int, default=100)
    given = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as room:
        source = given.run or small_run(Path(room, "small"))
        folder = multiplied(source, Path(room, "large"), given.episodes, given.vehicles)
        begun = time.process_time()
        page = write_report(folder)
        spent, size = time.process_time() - begun, page.stat().st_size / 1e6
        print(f"{given.episodes} episodes: written in {spent:.1f} s of one core, {size:.1f} MB")
        if program is None:
            print("no Chromium here: not opened")
            return 0
        timing = opened(page, program)
    gaps, draws = timing["gaps_ms"], timing["draws_ms"]
    print(f"opened in {timing['load_s']:.2f} s; {timing['vehicles']} vehicles in the first episode")
    for name, values in (("between frames while playing", gaps), ("to draw an instant", draws)):
        worst = float(np.percentile(values, 95))
        print(f"{name}: median {statistics.median(values):.1f} ms, 95 % {worst:.1f} ms ({len(values)})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
