"""Write or check docs/defects.md: the catalogue from the code, baseline and findings from docs/tables.

    write_defects_doc.py [--check]

The tables are those that ``tools/results_tables.toml`` names under ``defects``; ``tools/write_results.py`` makes them
from folders of ``bench defects``.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from write_outputs_doc import write_or_check
from write_results import PROVENANCE, TABLES, read_selection, tables_of

from advdiff_sumo.experiments.bench.bench_rows import policy_row
from advdiff_sumo.experiments.bench.defect_cells import SOUND
from advdiff_sumo.experiments.bench.defect_score import SCORE
from advdiff_sumo.experiments.bench.detection import LEVEL, ranking_auc
from advdiff_sumo.planners.defects.catalogue import catalogue_table

PAGE = Path(__file__).resolve().parents[1] / "docs" / "defects.md"
PUBLISHED_SEVERITY = "strong"
_PLACE = re.compile(r"(<!-- catalogue -->\n).*?(<!-- end -->)", re.DOTALL)
_BASELINE = re.compile(r"(<!-- baseline -->\n).*?(<!-- end of baseline -->)", re.DOTALL)
_FINDINGS = re.compile(r"(<!-- findings -->\n).*?(<!-- end of findings -->)", re.DOTALL)


def filled(page: str) -> str:
    """Return *page* with the catalogue of the code, and with baseline and findings of docs/tables."""
    selection = read_selection()
    names, findings_names = tables_of("defects", selection), selection["defects"].get("findings", [])
    page = _PLACE.sub(lambda place: place[1] + catalogue_table() + place[2], page)
    page = _BASELINE.sub(lambda place: place[1] + baseline(names) + place[2], page)
    return _FINDINGS.sub(lambda place: place[1] + findings(findings_names, rankings(names)) + place[2], page)


def baseline(names: list[str]) -> str:
    """Return the valid failures in the tables *names* in whole percent, one row for each strong defect, and the score.

    Detected defects are bold.
    """
    provenance = json.loads((TABLES / PROVENANCE).read_text(encoding="utf-8"))
    cells = {(line["target"], line["row"], line["column"]): line for line in _lines(names, "")}
    detected = {
        (line["target"], line["ours"], line["column"])
        for line in _lines(names, "-differences")
        if float(line["difference"]) > 0.0 and float(line["p"]) < LEVEL
    }
    rows = dict.fromkeys((target, row) for target, row, _ in cells)
    columns = tuple(dict.fromkeys(column for _, _, column in cells))
    text = (
        f"|  | {' | '.join(policy_row(column).title for column in columns)} |\n|---|{'--:|' * len(columns)}\n"
    )
    for target, row in rows:
        shown = (
            _cell_text(cells.get((target, row, column)), (target, row, column) in detected)
            for column in columns
        )
        name = f"{target}, {row}" if row == SOUND else row.removesuffix(f":{PUBLISHED_SEVERITY}")
        text += f"| {name} | {' | '.join(shown)} |\n"
    scenes = {name: provenance[name]["title"].partition(": ")[2] for name in names}
    return f"Valid failures in % of the episodes. {_runs_text(_shown(names), scenes)}:\n\n{text}"


def rankings(names: list[str]) -> dict[str, float]:
    """Return column → AUC with which the valid failures in *names* rank defective above sound planners."""
    rates: dict[str, tuple[list[float], list[float]]] = {}
    for line in _lines(names, ""):
        if line["row"] != SCORE and line["value"]:
            sound, defective = rates.setdefault(line["column"], ([], []))
            (sound if line["row"] == SOUND else defective).append(float(line["value"]))
    ranked = {column: ranking_auc(*pair) for column, pair in rates.items()}
    return {column: auc for column, auc in ranked.items() if auc is not None}


def findings(names: list[str], ranked: dict[str, float]) -> str:
    """Return a table about the collisions of ``lane_graph``, sound and with each defect; one row for each background.

    Args:
        names: tables of findings.
        ranked: background → AUC.
    """
    counts = ("collisions", "valid, %", "the other broke a rule, %", "kinds per 100 episodes")
    heads = (*counts, "first detection of a defect, CPU s", "AUC")
    text = f"|  | {' | '.join(heads)} |\n|---|{'--:|' * len(heads)}\n"
    for line in _lines(names, "-findings"):
        if line["target"] == "lane_graph":
            collisions = int(line["collisions"])
            shares = (f"{100 * int(line[key]) / max(collisions, 1):.1f}" for key in ("valid", "others_broke"))
            rest = (line["cells_per_100"] or "–", line["median_first_cpu_s"] or "–")
            auc, title = f"{ranked[line['background']]:.3f}", policy_row(line["background"]).title
            cells = (title, str(collisions), *shares, *rest, auc)
            text += f"| {' | '.join(cells)} |\n"
    return text


def _runs_text(shown: Mapping[str, list[str]], scenes: Mapping[str, str]) -> str:
    """Return the *scenes* and a link for each table, with the titles of its columns *shown*."""
    links = {
        name: f"[{', '.join(policy_row(column).title for column in columns)}](tables/{name}.csv)"
        for name, columns in shown.items()
    }
    if len(set(scenes.values())) == 1:
        return f"{next(iter(scenes.values()))}; CSV: {'; '.join(links.values())}"
    return "; ".join(f"{link}: {scenes[name]}" for name, link in links.items())


def _lines(names: list[str], which: str) -> list[dict[str, str]]:
    """Return the lines of all tables *names*; each column, a background, is taken from the last that has it."""
    shown = _shown(names)
    lines = ((name, line) for name in names for line in _read(f"{name}{which}"))
    return [
        line for name, line in lines if line.get("column", line.get("background", "")) in (*shown[name], "")
    ]


def _shown(names: list[str]) -> dict[str, list[str]]:
    """Return table → its columns that no later table has, in order."""
    columns = {name: list(dict.fromkeys(line["column"] for line in _read(name))) for name in names}
    last = {column: name for name, own in columns.items() for column in own}
    return {name: [column for column in own if last[column] == name] for name, own in columns.items()}


def _read(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((TABLES / f"{name}.csv").read_text(encoding="utf-8").splitlines()))


def _cell_text(line: dict[str, str] | None, detected: bool) -> str:
    if line is None or not line["value"]:
        return "–"
    value = float(line["value"])
    if line["row"] == SCORE:
        return f"{value * int(line['n']) / 100.0:.0f} of {line['n']}"
    return f"**{value:.0f}**" if detected else f"{value:.0f}"


def main() -> int:
    """Write the page; with ``--check``, return 1 if it is not up to date."""
    return write_or_check(PAGE, filled, __doc__, "the code or docs/tables")


if __name__ == "__main__":
    sys.exit(main())
