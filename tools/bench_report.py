"""Measure the size and speed of a large report: bench_report.py [--run FOLDER] [--episodes 200] [--vehicles 100].

The episodes of a real run are repeated, and copies of their vehicles are added. Then the page is opened in Chromium
without a graphics card.
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
    """Run four guided episodes into *folder* and return it."""
    values = {"target": "lane_graph", "background": "diffusion", "episodes": 4, "horizon_s": 20.0}
    run = Run.prepare(RunOptions.parse(values | {"sim": {"stop_at_collision": False}}))
    run_into(run, RunFolder.create(folder, run.settings, resume=False), SerialExecutor(), lambda *_: None)
    return folder


def multiplied(source: Path, folder: Path, episodes: int, vehicles: int) -> Path:
    """Write the tables of the run *source* into *folder*, and return it.

    Args:
        source: folder of a run.
        folder: new folder.
        episodes: number of episodes; those of *source* are repeated in turn.
        vehicles: least number of vehicles in each; copies are added.
    """
    folder.mkdir(parents=True)
    source_tables = {name: pq.read_table(source / f"{name}.parquet") for name in TABLES}
    numbers = source_tables["episodes"]["episode"].to_pylist()
    parts: dict[str, list[pa.Table]] = {name: [] for name in TABLES}
    for number in range(episodes):
        for name, table in source_tables.items():
            part = table.filter(pc.equal(table["episode"], numbers[number % len(numbers)]))
            if name == "states":
                part = _with_copies(part, vehicles)
            column = part.column_names.index("episode")
            parts[name].append(part.set_column(column, "episode", pa.array(np.full(part.num_rows, number))))
    for name, tables in parts.items():
        pq.write_table(pa.concat_tables(tables), folder / f"{name}.parquet", compression="zstd")
    settings = source / "run.toml"
    if settings.exists():
        shutil.copy(settings, folder)
    else:
        _write_run_settings(folder)
    return folder


def _write_run_settings(folder: Path) -> None:
    options = {"net": "downtown", "target": "lane_graph", "background": "diffusion"}
    (folder / "run.toml").write_text(tomli_w.dumps({"options": options}), encoding="utf-8")


def _with_copies(states: pa.Table, vehicles: int) -> pa.Table:
    """Return *states* with shifted copies of all vehicles but the target, up to at least *vehicles*."""
    others = states.filter(pc.invert(states["is_target"]))
    tables, count, copy = [states], len(pc.unique(states["agent"])), 0
    others_count = max(1, count - 1)
    while count < vehicles and others.num_rows:
        copy += 1
        shifted = others
        for name, offset_m in (("x_m", 3.1 * copy), ("y_m", -2.3 * copy)):
            column = shifted.column_names.index(name)
            shifted = shifted.set_column(column, name, pc.add(others[name], offset_m))
        names = pc.binary_join_element_wise(others["agent"], f"c{copy}", "-")
        tables.append(shifted.set_column(shifted.column_names.index("agent"), "agent", names))
        count += others_count
    return pa.concat_tables(tables)


def page_timing(page_file: Path, program: str) -> dict[str, Any]:
    """Open *page_file* in the browser *program*; return its load time in s, and frame gaps and draw times in ms."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_context(viewport={"width": 1360, "height": 900}, offline=True).new_page()
        start = time.perf_counter()
        page.goto(page_file.as_uri())
        page.wait_for_selector("#player[data-episode]", timeout=120_000)
        load_s = time.perf_counter() - start
        vehicles = page.evaluate("document.getElementById('player').player.episode.agents.length")
        gaps, spent = page.evaluate(_PLAY, [0.0, 8.0])
        browser.close()
    return {"load_s": load_s, "vehicles": vehicles, "gaps_ms": gaps[1:], "draws_ms": spent}


def main() -> int:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, help="folder of a run or sweep; a small guided run otherwise")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--vehicles", type=int, default=100)
    given = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as scratch:
        source = given.run or small_run(Path(scratch, "small"))
        folder = multiplied(source, Path(scratch, "large"), given.episodes, given.vehicles)
        start = time.process_time()
        page = write_report(folder)
        cpu_s, size = time.process_time() - start, page.stat().st_size / 1e6
        print(f"{given.episodes} episodes: written in {cpu_s:.1f} s of one core, {size:.1f} MB")
        if program is None:
            print("no Chromium here: not opened")
            return 0
        timing = page_timing(page, program)
    gaps, draws = timing["gaps_ms"], timing["draws_ms"]
    print(f"opened in {timing['load_s']:.2f} s; {timing['vehicles']} vehicles in the first episode")
    for name, values in (("between frames while playing", gaps), ("to draw an instant", draws)):
        p95 = float(np.percentile(values, 95))
        print(f"{name}: median {statistics.median(values):.1f} ms, 95 % {p95:.1f} ms ({len(values)})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
