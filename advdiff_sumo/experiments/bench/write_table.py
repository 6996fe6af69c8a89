"""Writes a bench's table as files: CSV, LaTeX, Markdown and JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from advdiff_sumo.experiments.bench import formatting
from advdiff_sumo.experiments.bench.table import Cell, Head, Table
from advdiff_sumo.sweep.sweep_files import write_whole

_LATEX_ESCAPES = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "²": r"\textsuperscript{2}",
    "³": r"\textsuperscript{3}",
    "–": "--",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "α": r"$\alpha$",
    "→": r"$\to$",
    "⁻": r"\textsuperscript{--}",
}


def write_files(folder: Path, table: Table) -> None:
    """Write ``table.csv``, ``differences.csv``, ``timing.csv``, ``table.tex``, ``table.md`` and ``table.json``.

    Only ``timing.csv``, ``table.tex`` and ``table.md`` hold measured times; the others are the same on every machine.

    Raises:
        FileError: one cannot be written.
    """
    deterministic = tuple(head for head in table.heads if not head.measured)
    timed = tuple(head for head in table.heads if head.measured)
    write_whole(folder / "table.csv", csv_text(table, deterministic).encode())
    if timed:
        write_whole(folder / "timing.csv", csv_text(table, timed).encode())
    write_whole(folder / "differences.csv", differences_text(table).encode())
    write_whole(folder / "table.tex", latex_text(table).encode())
    write_whole(folder / "table.md", markdown_text(table).encode())
    write_whole(folder / "table.json", json_text(table, deterministic).encode())


def csv_text(table: Table, heads: Sequence[Head]) -> str:
    """Return one line for each row and column: figure, interval, sample size, and the paper's figure."""
    return formatting.comma_separated(
        ("target", "row", "column", "unit", "value", "low", "high", "n", "paper"),
        (
            (line.group, line.title, head.key, head.unit, *_values(line.cells[head.key], head))
            for line in table.lines
            for head in heads
            if head.key in line.cells
        ),
    )


def differences_text(table: Table) -> str:
    """Return the differences to rivals, one per line."""
    names = ("target", "column", "unit", "ours", "rival", "difference", "low", "high", "p", "scenes")
    heads, rows = {head.key: head for head in table.heads}, []
    for gap in table.gaps:
        head, difference = heads[gap.column], gap.found
        scaled = (_scaled(value, head) for value in (difference.value, difference.low, difference.high))
        p = "" if difference.p is None else f"{difference.p:.6g}"
        rows.append((gap.group, gap.column, head.unit, gap.ours, gap.rival, *scaled, p, difference.scenes))
    return formatting.comma_separated(names, rows)


def json_text(table: Table, heads: Sequence[Head]) -> str:
    """Return the table without its measured columns as JSON."""
    keys = {head.key for head in heads}
    plain = asdict(table)
    plain["heads"] = [head for head in plain["heads"] if head["key"] in keys]
    for line in plain["lines"]:
        line["cells"] = {key: cell for key, cell in line["cells"].items() if key in keys}
    return json.dumps(plain, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def latex_text(table: Table) -> str:
    r"""Return a table for LaTeX; it needs the packages booktabs, xcolor and graphicx, the latter for ``\resizebox``."""
    has_groups = any(line.group for line in table.lines)
    columns = ("l" if has_groups else "") + "l" + "r" * len(table.heads)
    titles = [
        *([""] if has_groups else []),
        "",
        *(escaped_latex(formatting.heading(head)) for head in table.heads),
    ]
    body, previous_group = [], None
    for line in table.lines:
        if previous_group is not None and line.group != previous_group:
            body.append(r"\midrule")
        label = [escaped_latex(line.group) if line.group != previous_group else ""] if has_groups else []
        cells = (_latex_cell(line.cells.get(head.key), head) for head in table.heads)
        body.append(" & ".join((*label, escaped_latex(line.title), *cells)) + r" \\")
        previous_group = line.group
    rows = "\n".join(body)
    return (
        "% needs booktabs, xcolor, graphicx\n"
        "\\begin{table*}\n\\centering\n"
        f"\\caption{{{escaped_latex(table.title)}. Intervals are 95\\,\\%; grey: the paper's own figures.}}\n"
        f"\\label{{tab:{table.bench}}}\n\\resizebox{{\\linewidth}}{{!}}{{%\n\\begin{{tabular}}{{{columns}}}\n"
        f"\\toprule\n{' & '.join(titles)} \\\\\n\\midrule\n{rows}\n\\bottomrule\n"
        "\\end{tabular}}\n\\end{table*}\n"
    )


def markdown_text(table: Table) -> str:
    """Return the table, its differences and notes as Markdown."""
    has_groups = any(line.group for line in table.lines)
    titles = [*(["target"] if has_groups else []), "", *(formatting.heading(head) for head in table.heads)]
    rows = [titles, ["---"] * len(titles)]
    for line in table.lines:
        cells = [_markdown_cell(line.cells.get(head.key), head) for head in table.heads]
        rows.append([*([line.group] if has_groups else []), line.title, *cells])
    text = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    if table.gaps:
        text += "\n" + _markdown_gaps(table)
    notes = "".join(f"- {note}\n" for note in table.notes)
    return f"**{table.title}**\n\n{text}\n{notes}"


def escaped_latex(text: str) -> str:
    """Return *text* with LaTeX's special characters escaped."""
    return "".join(_LATEX_ESCAPES.get(letter, letter) for letter in text)


def _markdown_gaps(table: Table) -> str:
    heads = {head.key: head for head in table.heads}
    is_defects = table.bench == "defects"  # which compares each row with the sound one
    titles = "compared | difference" if is_defects else "best rival | ours less it"
    text = f"| target | figure | {titles} | 95 % | McNemar | scenes |\n|---|---|---|---|---|---|---|\n"
    for gap in table.gaps:
        head, difference = heads[gap.column], gap.found
        interval = formatting.interval(difference.low, difference.high, head)
        pair = f"{gap.ours} less {gap.rival}" if is_defects else gap.rival
        cells = (gap.group, formatting.heading(head), pair, formatting.change(difference, head), interval)
        text += f"| {' | '.join((*cells, formatting.p_value(difference.p), str(difference.scenes)))} |\n"
    return text


def _markdown_cell(cell: Cell | None, head: Head) -> str:
    if cell is None:
        return formatting.NOTHING
    value = formatting.number(cell.found.value, head)
    parts = [
        f"**{value}**" if cell.best else value,
        formatting.interval(cell.found.low, cell.found.high, head),
    ]
    paper = formatting.paper_number(cell)
    parts += [f"n {cell.found.n}" if cell.found.n else "", f"*paper {paper}*" if paper else ""]
    return " ".join(part for part in parts if part)


def _latex_cell(cell: Cell | None, head: Head) -> str:
    if cell is None:
        return "--"
    value = escaped_latex(formatting.number(cell.found.value, head))
    parts = [f"\\textbf{{{value}}}" if cell.best else value]
    interval = formatting.interval(cell.found.low, cell.found.high, head)
    if interval:
        parts.append(f"{{\\scriptsize {interval}}}")
    paper = formatting.paper_number(cell)
    if paper:
        parts.append(f"\\textcolor{{gray}}{{{paper}}}")
    return " ".join(parts)


def _values(cell: Cell, head: Head) -> tuple[str, ...]:
    estimate = cell.found
    scaled = (_scaled(value, head) for value in (estimate.value, estimate.low, estimate.high))
    return (*scaled, str(estimate.n), "" if cell.paper is None else f"{cell.paper:g}")


def _scaled(value: float | None, head: Head) -> str:
    return "" if value is None else f"{head.scale * value:.6g}"
