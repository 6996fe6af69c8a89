"""Print the results of a sweep, and determine the exit code."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from advdiff_sumo.cli.fitted_table import FittedTable
from advdiff_sumo.cli.summary import UNEXPLAINED
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import UNEXPLAINED_KINDS, FileError, os_reason
from advdiff_sumo.core.wording import counted, in_series
from advdiff_sumo.experiments.folder_rows import FolderRows
from advdiff_sumo.metrics.archive import MANOEUVRES, ArchiveCell, archive
from advdiff_sumo.metrics.near_miss import resolution_clause
from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_failure, is_valid_failure, worst_first
from advdiff_sumo.metrics.statistics import Rate
from advdiff_sumo.report.attack_words import plan_lines, position_lines
from advdiff_sumo.report.nets import place_names
from advdiff_sumo.sweep.condition import Condition, Undefined
from advdiff_sumo.sweep.coverage import bands, coverage
from advdiff_sumo.sweep.findings import Finding, findings
from advdiff_sumo.sweep.job_plan import SweepPlan
from advdiff_sumo.sweep.junit import junit_xml
from advdiff_sumo.sweep.summary_stats import FIGURE_NAMES, Figures, by_kind
from advdiff_sumo.sweep.sweep_columns import job_row
from advdiff_sumo.sweep.sweep_files import write_whole

CONDITION_MET = 1
_JUNIT_REMEDY = "choose another --junit"
_LISTED_WORST, _LISTED_FINDINGS = 20, 12
_UNFINISHED_TEXTS = {"failures": "episodes failed", "missing": "have not been run"}
#: Figures about episodes that did not finish.
_FAILURE_FIGURES = {
    "finished",
    "failures",
    "missing",
    "failure_rate",
    "failure_rate_low",
    "failure_rate_high",
}
#: Columns whose entries users copy; they are never broken.
_UNBROKEN_COLUMNS = ("key", "the worst of them")
#: Columns that a narrow terminal leaves out first if all their entries are equal.
_CONSTANT_COLUMNS = ("net", "background")
#: Columns of each table that a narrow terminal leaves out next, in this order.
_DISPENSABLE_RATES = ("arrives", "breaks rules", "critical", "at fault")
_DISPENSABLE_WORST = ("clearance", "TTC")
_DISPENSABLE_FINDINGS = ("targets", "where")

Row = Mapping[str, Any]


def condition_of(text: str | None) -> Condition | None:
    """Return the condition of ``--fail-if``; None if it is not given.

    Raises:
        ConfigError: *text* is not a condition.
    """
    return None if text is None else Condition(text, FIGURE_NAMES)


def conclude(console: Console, results: FolderRows, condition: Condition | None, junit: Path | None) -> None:
    """Print the results of the sweep, write JUnit XML, and exit with code 1 if the condition is met.

    Raises:
        FileError: *junit* cannot be written.
    """
    overall = Figures.of(results.episodes, results.failures, results.missing)
    verdict = None if condition is None else _gate(condition, overall)
    _print(console, results, overall)
    console.print(f"results: {results.path}", soft_wrap=True)
    if verdict is not None:
        console.print(verdict, style="red", soft_wrap=True)
    if junit is not None:
        _write_junit(junit, results, None if condition is None else (condition.text, verdict))
    if verdict is not None:
        raise typer.Exit(CONDITION_MET)
    if condition is not None and (ignored := _ignored_by(condition, overall)):
        terminal(stderr=True).print(f"note: {ignored}", style="yellow", soft_wrap=True)


def check_junit(path: Path | None) -> None:
    """Make the folder of the JUnit file *path*, if one is given.

    Raises:
        FileError: the folder cannot be made, or the file cannot be written into it.
    """
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", _JUNIT_REMEDY) from None
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        reason = "it is a folder" if path.is_dir() else "nothing can be written into its folder"
        raise FileError(path, f"cannot be written ({reason})", _JUNIT_REMEDY)


def _write_junit(path: Path, results: FolderRows, outcome: tuple[str, str | None] | None) -> None:
    """Write JUnit XML; *outcome* is the condition of ``--fail-if`` with the reason why it is met, or None."""
    check_junit(path)
    timing = {row["episode"]: row["wall_s"] for row in results.timing}
    continuation = results.how_to_go_on if results.missing else ""
    names = _net_names(results.episodes, results.failures)
    episodes, failures = (
        [{**row, "net": names[str(row["net"])]} for row in rows]
        for rows in (results.episodes, results.failures)
    )
    try:
        write_whole(path, junit_xml(episodes, failures, timing, outcome, continuation))
    except FileError as error:
        raise FileError(path, error.problem, _JUNIT_REMEDY) from None


def _net_names(*tables: Sequence[Row]) -> dict[str, str]:
    """Return net → readable name, which does not depend on the folder of the nets."""
    return place_names(dict.fromkeys(str(row["net"]) for rows in tables for row in rows))


def _gate(condition: Condition, overall: Figures) -> str | None:
    """Return why the condition is met or cannot be evaluated, since nothing was tested; None if it is not met."""
    if not overall.rates["collision_rate"].total and not condition.names & _FAILURE_FIGURES:
        return f"--fail-if {condition.text}: no episode finished, so that nothing was tested"
    return condition_met(condition, overall.named())


def _ignored_by(condition: Condition, overall: Figures) -> str:
    """Return a note on failed and missing episodes if the condition does not consider them; "" if there are none."""
    figures = overall.named()
    unfinished = [f"{figures[name]} {text}" for name, text in _UNFINISHED_TEXTS.items() if figures[name]]
    if not unfinished or condition.names & _FAILURE_FIGURES:
        return ""
    return (
        f"{in_series(unfinished)}, which --fail-if {condition.text} does not ask about; "
        'add "or failures > 0 or missing > 0"'
    )


def condition_met(condition: Condition, named: Mapping[str, float | None]) -> str | None:
    """Return why the condition is met or cannot be evaluated; None if it is not met.

    Args:
        condition: that of ``--fail-if``.
        named: figures by name; None: undefined.
    """
    try:
        is_met = condition.holds(named)
    except Undefined as error:
        return f"--fail-if {condition.text}: {error}"
    return f"--fail-if {condition.text}: {condition.values_text(named) or 'always so'}" if is_met else None


def _print(console: Console, results: FolderRows, overall: Figures) -> None:
    """Print all tables of *results*; *overall* holds the figures of all episodes."""
    episodes, failures = results.episodes, results.failures
    _print_rates(console, episodes, failures, overall)
    finished = [row for row in episodes if has_outcome(row)]
    for subject, text in (*position_lines(finished), *plan_lines(episodes)):
        console.print(f"{subject} {text}", soft_wrap=True)
    if overall.missing:
        lacking = f"{counted(overall.missing, 'episode')} not run yet"
        console.print(f"{lacking}; {results.remedy}", style="yellow", soft_wrap=True)
    if failures:
        _print_failures(console, failures)
    clusters = findings(episodes)
    if clusters:
        _print_findings(console, clusters)
    if episodes:
        print_worst(console, worst_first(episodes)[:_LISTED_WORST])
        _print_coverage(console, results.plan, episodes)
    if not results.of_run or any(row["attacker_manoeuvre"] is not None for row in episodes):
        _print_archive(console, episodes)  # a finished run may lack the manoeuvres of vehicles


def _print_rates(
    console: Console, episodes: Sequence[Row], failures: Sequence[Row], overall: Figures
) -> None:
    situations = {row.get("situation") for row in (*episodes, *failures)}
    by_situation = ("situation",) if len(situations) > 1 else ()
    table = _table(
        f"{counted(overall.episodes, 'episode')}; rates in % with 95 % Wilson intervals",
        *(
            "target",
            "background",
            "net",
            *by_situation,
            "n",
            "valid failures",
            "critical",
            "breaks rules",
            "collides",
            "at fault",
            "arrives",
            "failed",
        ),
        dispensable=(*_DISPENSABLE_RATES, "failed") if failures else ("failed", *_DISPENSABLE_RATES),
    )
    columns = ("target", "target_options", "background", "background_options", "net", *by_situation)
    names = _net_names(episodes, failures)
    for key, figures in by_kind(episodes, failures, columns).items():
        target, target_options, background, background_options, net, *situation = key
        table.add_row(
            target + _options_text(target_options),
            background + _options_text(background_options),
            names[net],
            *situation,
            *_rate_cells(figures),
        )
    table.add_section()
    blanks = ["" for _ in ("background", "net", *by_situation)]
    by_target = by_kind(episodes, failures, ("target", "target_options"))
    if len(by_target) > 1:
        for (target, options), figures in by_target.items():
            table.add_row(f"all of {target}{_options_text(options)}", *blanks, *_rate_cells(figures))
    table.add_row("all", *blanks, *_rate_cells(overall))
    table.print(console)


def _rate_cells(figures: Figures) -> list[str]:
    names = (
        "valid_failure_rate",
        "critical_rate",
        "offence_rate",
        "collision_rate",
        "fault_rate",
        "completion_rate",
        "failure_rate",
    )
    return [str(figures.episodes), *(rate_text(figures.rates[name]) for name in names)]


def rate_text(rate: Rate) -> str:
    """Return a rate with its interval, in percent; "–" if it is undefined."""
    if rate.share is None or rate.low is None or rate.high is None:
        return "–"
    return f"{100 * rate.share:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def _print_failures(console: Console, failures: Sequence[Row]) -> None:
    table = _table("failed episodes", "kind", "count", "the first of them", "repeat it")
    first = {row["kind"]: row for row in reversed(failures)}
    for kind, count in sorted(Counter(row["kind"] for row in failures).items()):
        table.add_row(kind, str(count), first[kind]["message"], first[kind]["command"])
    table.print(console)
    for kind in sorted(first.keys() & UNEXPLAINED_KINDS):
        console.print(f"{kind}: {UNEXPLAINED}", style="red", soft_wrap=True)


def _print_findings(console: Console, clusters: Sequence[Finding]) -> None:
    total = sum(len(finding.episodes) for finding in clusters)
    valid = sum(finding.valid for finding in clusters)
    title = f"{counted(len(clusters), 'finding')} in {counted(total, 'collision')}; valid failures: {valid}"
    heads = ("valid", "collisions", "type", "where", "at fault", "targets", "the worst of them")
    table = _table(title, *heads, dispensable=_DISPENSABLE_FINDINGS)
    for finding in clusters[:_LISTED_FINDINGS]:
        table.add_row(
            str(finding.valid),
            str(len(finding.episodes)),
            finding.type,
            finding.junction_type,
            _counts_text(finding.at_fault),
            _counts_text(
                {name + _options_text(options): count for (name, options), count in finding.targets.items()}
            ),
            str(finding.worst["key"]),
        )
    table.print(console)
    if len(clusters) > _LISTED_FINDINGS:
        console.print(f"… and {len(clusters) - _LISTED_FINDINGS} more")


def print_worst(console: Console, rows: Sequence[Row]) -> None:
    """Print *rows* of episodes; targets and backgrounds have the same names, with options, as in the table of rates."""
    table = _table(
        "the worst episode" if len(rows) == 1 else f"the {len(rows)} worst episodes",
        "key",
        "target",
        "background",
        "what",
        "TTC",
        "clearance",
        dispensable=_DISPENSABLE_WORST,
    )
    for row in rows:
        outcome = row["end"]
        if row["target_collision"]:
            outcome = f"{row['collision_type']}, at fault: {row['at_fault']}"
            outcome = f"valid failure: {outcome}" if is_valid_failure(row) else outcome
            outcome += ", then failed" if is_failure(row) else ""
        elif row.get("critical"):
            who = f" with {row['near_miss_partner']}" if row.get("near_miss_partner") else ""
            outcome = f"critical near miss{who}, {resolution_clause(row['resolved_by'])}"
        elif broke_rule(row):
            outcome = f"broke a rule: {str(row['offences']).replace('_', ' ')}"
        values = (_value_text(row["min_ttc_s"], "s"), _value_text(row["min_clearance_m"], "m"))
        sides = (row[side] + _options_text(row[f"{side}_options"]) for side in ("target", "background"))
        table.add_row(row["key"], *sides, outcome, *values)
    table.print(console)


def _print_coverage(console: Console, plan: SweepPlan, episodes: Sequence[Row]) -> None:
    attacks = [job_row(plan.jobs[0], options)["attack"] for options in plan.cells]
    covered = coverage(episodes, attacks, plan.junction_types)
    combinations = counted(len(covered.cells), "combination")
    table = _table(
        f"coverage: {100 * covered.share:.0f} % of {combinations}; collisions / episodes",
        *("attack", "junction", *bands()),
    )
    untried: dict[str, list[str]] = {}
    for attack, junction in product(covered.attacks, covered.junctions):
        cells = [covered.cells[attack, junction, band] for band in bands()]
        if any(cell.episodes for cell in cells):
            counts = (f"{c.collisions} / {c.episodes}" if c.episodes else "–" for c in cells)
            table.add_row(attack, junction, *counts)
        else:
            untried.setdefault(attack, []).append(junction)
    table.print(console)
    for attack, junctions in untried.items():
        console.print(f"no episode of {attack} at: {', '.join(junctions)}", soft_wrap=True)


def _print_archive(console: Console, episodes: Sequence[Row]) -> None:
    """Print which kinds of encounters occurred, and in which of them targets failed; only if a background attacked."""
    cells = archive(row for row in episodes if row["attack_kind"] is not None)
    if not cells:
        return
    filled = sum(elite.valid > 0 for elite in cells.values())
    table = _table(
        f"archive: encounters of {counted(len(cells), 'kind')}, valid failures in {filled} of them; "
        "valid failures / episodes",
        *("attack", "the other comes", *MANOEUVRES),
    )
    for kind, approach in dict.fromkeys((cell.kind, cell.approach) for cell in cells):
        elites = (cells.get(ArchiveCell(kind, approach, manoeuvre)) for manoeuvre in MANOEUVRES)
        table.add_row(kind, approach, *(f"{e.valid} / {e.episodes}" if e else "–" for e in elites))
    table.print(console)


def _table(title: str, *columns: str, dispensable: Sequence[str] = ()) -> FittedTable:
    return FittedTable(title, columns, _UNBROKEN_COLUMNS, _CONSTANT_COLUMNS, dispensable)


def _counts_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def _options_text(options: str) -> str:
    """Return *options*, a JSON object, in short form with a leading space; "" if there are none."""
    return "" if options == "{}" else " " + options.strip("{}").replace(',"', ', "').replace('"', "")


def _value_text(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.2f} {unit}"


def duration(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400.0 else f"{seconds / 3600:.1f} h"
