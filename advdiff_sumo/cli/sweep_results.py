"""What is printed of a sweep, and what becomes the exit code."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
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
from advdiff_sumo.metrics.severity import has_outcome, is_failure, is_valid_failure, worst_first
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
_OTHER_JUNIT = "choose another --junit"
_WORST, _FINDINGS = 20, 12
_LACKING = {"failures": "episodes failed", "missing": "have not been run"}
#: Figures that tell of episodes that did not finish.
_OF_FAILURES = {"finished", "failures", "missing", "failure_rate", "failure_rate_low", "failure_rate_high"}
#: Columns whose entries are copied, and so never broken.
_WHOLE = ("key", "the worst of them")
#: Columns that a narrow terminal can do without where all rows say the same, and those that go then.
_ALIKE = ("net", "background")
_OF_RATES = ("arrives", "breaks rules", "critical", "at fault")
_OF_WORST = ("clearance", "TTC")
_OF_FINDINGS = ("targets", "where")

Row = Mapping[str, Any]


def condition_of(text: str | None) -> Condition | None:
    """Return the condition of ``--fail-if``.

    Raises:
        ConfigError: it is none.
    """
    return None if text is None else Condition(text, FIGURE_NAMES)


def conclude(console: Console, results: FolderRows, condition: Condition | None, junit: Path | None) -> None:
    """Print what the sweep came to, write JUnit XML, and leave with code 1 where the condition is met.

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
    if condition is not None and (untested := _untested(condition, overall)):
        terminal(stderr=True).print(f"note: {untested}", style="yellow", soft_wrap=True)


def check_junit(path: Path) -> None:
    """Make the folder of a JUnit file.

    Raises:
        FileError: it cannot be made, or the file not be written into it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", _OTHER_JUNIT) from None
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        reason = "it is a folder" if path.is_dir() else "nothing can be written into its folder"
        raise FileError(path, f"cannot be written ({reason})", _OTHER_JUNIT)


def _write_junit(path: Path, results: FolderRows, outcome: tuple[str, str | None] | None) -> None:
    check_junit(path)
    timing = {row["episode"]: row["wall_s"] for row in results.timing}
    lacking = results.how_to_go_on if results.missing else ""
    names = _net_names(results.episodes, results.failures)
    episodes, failures = (
        [{**row, "net": names[str(row["net"])]} for row in rows]
        for rows in (results.episodes, results.failures)
    )
    try:
        write_whole(path, junit_xml(episodes, failures, timing, outcome, lacking))
    except FileError as error:
        raise FileError(path, error.problem, _OTHER_JUNIT) from None


def _net_names(*tables: Sequence[Row]) -> dict[str, str]:
    """Return net → its name as one reads it, the same wherever the folder of the nets lies."""
    return place_names(dict.fromkeys(str(row["net"]) for rows in tables for row in rows))


def _gate(condition: Condition, overall: Figures) -> str | None:
    """Return why the condition is met, or cannot be asked since nothing was tested; None where it is not met."""
    named = overall.named()
    if not overall.rates["collision_rate"].total and not condition.names & _OF_FAILURES:
        return f"--fail-if {condition.text}: no episode finished, so that nothing was tested"
    return condition_met(condition, named)


def _untested(condition: Condition, overall: Figures) -> str:
    """Return what the condition leaves out of sight: episodes that failed or have not been run; "" for nothing."""
    named = overall.named()
    lacking = [f"{named[name]} {words}" for name, words in _LACKING.items() if named[name]]
    if not lacking or condition.names & _OF_FAILURES:
        return ""
    return (
        f"{in_series(lacking)}, which --fail-if {condition.text} does not ask about; "
        'add "or failures > 0 or missing > 0"'
    )


def condition_met(condition: Condition, named: Mapping[str, float | None]) -> str | None:
    """Return why the condition is met by the figures that are *named*, or cannot be asked; None where it is not."""
    try:
        met = condition.holds(named)
    except Undefined as error:
        return f"--fail-if {condition.text}: {error}"
    return f"--fail-if {condition.text}: {condition.told(named) or 'always so'}" if met else None


def _print(console: Console, results: FolderRows, overall: Figures) -> None:
    episodes, failures = results.episodes, results.failures
    _print_rates(console, episodes, failures, overall)
    finished = [row for row in episodes if has_outcome(row)]
    for what, where in (*position_lines(finished), *plan_lines(episodes)):
        console.print(f"{what} {where}", soft_wrap=True)
    if overall.missing:
        console.print(f"{counted(overall.missing, 'episode')} not run yet", style="yellow")
    if failures:
        _print_failures(console, failures)
    clusters = findings(episodes)
    if clusters:
        _print_findings(console, clusters)
    if episodes:
        print_worst(console, worst_first(episodes)[:_WORST])
        _print_coverage(console, results.plan, episodes)
    if not results.of_run or any(row["attacker_manoeuvre"] is not None for row in episodes):
        _print_archive(console, episodes)  # what each vehicle did is not kept by a finished run


def _print_rates(
    console: Console, episodes: Sequence[Row], failures: Sequence[Row], overall: Figures
) -> None:
    table = _table(
        f"{counted(overall.episodes, 'episode')}; rates in % with 95 % Wilson intervals",
        *(
            "target",
            "background",
            "net",
            "n",
            "valid failures",
            "critical",
            "breaks rules",
            "collides",
            "at fault",
            "arrives",
            "failed",
        ),
        dispensable=(*_OF_RATES, "failed") if failures else ("failed", *_OF_RATES),
    )
    columns = ("target", "target_options", "background", "background_options", "net")
    names = _net_names(episodes, failures)
    for key, figures in by_kind(episodes, failures, columns).items():
        target, target_options, background, background_options, net = key
        table.add_row(
            target + _short(target_options),
            background + _short(background_options),
            names[net],
            *_cells(figures),
        )
    table.add_section()
    table.add_row("all", "", "", *_cells(overall))
    table.print(console)


def _cells(figures: Figures) -> list[str]:
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
    """Return a rate with its interval, in percent."""
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
    table = _table(title, *heads, dispensable=_OF_FINDINGS)
    for finding in clusters[:_FINDINGS]:
        table.add_row(
            str(finding.valid),
            str(len(finding.episodes)),
            finding.type,
            finding.junction_type,
            _counts(finding.at_fault),
            _counts({name + _short(options): count for (name, options), count in finding.targets.items()}),
            str(finding.worst["key"]),
        )
    table.print(console)
    if len(clusters) > _FINDINGS:
        console.print(f"… and {len(clusters) - _FINDINGS} more")


def print_worst(console: Console, rows: Sequence[Row]) -> None:
    """Print *rows* of episodes, each with the options that its target and background have in the table of rates."""
    table = _table(
        "the worst episode" if len(rows) == 1 else f"the {len(rows)} worst episodes",
        "key",
        "target",
        "background",
        "what",
        "TTC",
        "clearance",
        dispensable=_OF_WORST,
    )
    for row in rows:
        what = row["end"]
        if row["target_collision"]:
            what = f"{row['collision_type']}, at fault: {row['at_fault']}"
            what = f"valid failure: {what}" if is_valid_failure(row) else what
            what += ", then failed" if is_failure(row) else ""
        elif row.get("critical"):
            what = f"critical near miss, {resolution_clause(row['resolved_by'])}"
        values = (_value(row["min_ttc_s"], "s"), _value(row["min_clearance_m"], "m"))
        who = (row[side] + _short(row[f"{side}_options"]) for side in ("target", "background"))
        table.add_row(row["key"], *who, what, *values)
    table.print(console)


def _print_coverage(console: Console, plan: SweepPlan, episodes: Sequence[Row]) -> None:
    attacks = [job_row(plan.jobs[0], options)["attack"] for options in plan.cells]
    tried = coverage(episodes, attacks, plan.junction_types)
    table = _table(
        f"coverage: {100 * tried.share:.0f} % of {counted(len(tried.cells), 'combination')}; collisions / episodes",
        *("attack", "junction", *bands()),
    )
    for attack in tried.attacks:
        for junction in tried.junctions:
            cells = (tried.cells[attack, junction, band] for band in bands())
            counts = (f"{c.collisions} / {c.episodes}" if c.episodes else "–" for c in cells)
            table.add_row(attack, junction, *counts)
    table.print(console)


def _print_archive(console: Console, episodes: Sequence[Row]) -> None:
    """Print which encounters came about and in which of them targets failed, where a background attacked."""
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
    return FittedTable(title, columns, _WHOLE, _ALIKE, dispensable)


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def _short(options: str) -> str:
    return "" if options == "{}" else " " + options.strip("{}").replace(',"', ', "').replace('"', "")


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.2f} {unit}"


def duration(seconds: float) -> str:
    """Return a duration as people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400.0 else f"{seconds / 3600:.1f} h"
