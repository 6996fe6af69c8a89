"""``advdiff-sumo compare``: compare two runs or sweeps episode by episode."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from advdiff_sumo.cli.fitted_table import FittedTable
from advdiff_sumo.cli.run_flags import Json
from advdiff_sumo.cli.terminal import print_json, terminal
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.experiments.folder_rows import FolderRows
    from advdiff_sumo.sweep.paired import Comparison
    from advdiff_sumo.sweep.summary_stats import Row

_LISTED_EPISODES = 8


@dataclass(frozen=True)
class _Side:
    """One side of the comparison.

    Attributes:
        letter: A or B.
        folder: its run or sweep.
        conditions: COLUMN=VALUE, which select episodes.
        of_run: whether the folder holds a run; else a sweep.
    """

    letter: str
    folder: Path
    conditions: Sequence[str]
    of_run: bool

    def __str__(self) -> str:
        return f"{self.letter}: {' · '.join((str(self.folder), *self.conditions))}"

    def repeat(self, number: int) -> str:
        """Return the command that repeats episode *number*."""
        option = "--run" if self.of_run else "--sweep"
        return f"advdiff-sumo replay {number} {option} {shlex.quote(str(self.folder))}"


def compare(
    first: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
    second: Annotated[Path, typer.Argument(help="Folder of another, or the same.", show_default=False)],
    choose_a: Annotated[
        list[str] | None, typer.Option("--a", help="Of the first only episodes with COLUMN=VALUE.")
    ] = None,
    choose_b: Annotated[list[str] | None, typer.Option("--b", help="The same for the second.")] = None,
    fail_if: Annotated[
        str | None,
        typer.Option(help='Exit with code 1 if so, for example "valid_failure_rate_only_b > 0".'),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare two runs or sweeps over the same seed scenes, episode by episode.

    advdiff-sumo compare runs/planners runs/planners --a target=IDM --b target=lane_graph

    advdiff-sumo compare runs/last-release runs/today --fail-if "valid_failure_rate_only_b > 0"

    Rates: exact McNemar test, and the difference with a bootstrap interval that draws whole seed scenes. A condition
    knows pairs, scenes, unpaired (also with _a and _b), failures_a and failures_b (failed ones among these), and of
    each rate of a sweep _a, _b, _only_a and _only_b (pairs in which it happened on one side alone), _change (b − a),
    _change_low, _change_high, and _p.
    """
    from advdiff_sumo.cli.sweep_results import CONDITION_MET, condition_met  # late: --help is quick
    from advdiff_sumo.sweep.condition import Condition
    from advdiff_sumo.sweep.paired import COMPARED_NAMES, NothingFinishedError, choose

    condition = None if fail_if is None else Condition(fail_if, COMPARED_NAMES)
    sides, episodes = [], []
    try:
        for letter, folder, conditions in (("A", first, choose_a or []), ("B", second, choose_b or [])):
            rows = _rows(folder)
            episodes.append(choose(rows.episodes, conditions, f"--{letter.lower()}"))
            sides.append(_Side(letter, folder, conditions, rows.of_run))
        comparison = _paired(episodes, sides)
    except NothingFinishedError as error:
        if condition is None:
            raise
        undecided = f"{error}: --fail-if {fail_if} cannot be tested"
        terminal(stderr=True, soft_wrap=True).print(undecided, style="red")
        if as_json:
            print_json({"error": undecided})
        raise typer.Exit(CONDITION_MET) from None
    console = terminal(quiet=as_json)
    _print(console, comparison, sides)
    if as_json:
        print_json(_json_object(comparison))
    if condition is None:
        return
    if (sentence := condition_met(condition, comparison.named())) is not None:
        console.print(sentence, style="red", soft_wrap=True)
        raise typer.Exit(CONDITION_MET)
    if comparison.unpaired and not condition.names & {"unpaired", "pairs"}:
        note = f"note: {_unpaired_text(comparison)}, which --fail-if does not ask about"
        terminal(stderr=True).print(f'{note}; add "or unpaired > 0"', style="yellow", soft_wrap=True)


def _rows(folder: Path) -> FolderRows:
    """Return the rows of *folder*; a note tells how to run the episodes that are missing."""
    from advdiff_sumo.experiments.folder_rows import rows_of_folder  # late, as above
    from advdiff_sumo.sweep.paired import NothingFinishedError

    rows = rows_of_folder(folder)
    if not rows.episodes:
        why = rows.how_to_go_on if rows.missing else "its failures say why"
        raise NothingFinishedError(f"{folder}: has no episode with results; {why}")
    if rows.missing:
        terminal(stderr=True).print(f"note: {folder}: {rows.how_to_go_on}", style="yellow", soft_wrap=True)
    return rows


def _paired(episodes: Sequence[Sequence[Row]], sides: Sequence[_Side]) -> Comparison:
    """Return the comparison of the two sides' episodes; an error says of which folders."""
    from advdiff_sumo.sweep.paired import compare as paired  # late, as above

    try:
        return paired(episodes[0], episodes[1])
    except ConfigError as error:
        raise type(error)(f"{' and '.join(str(side.folder) for side in sides)}: {error}") from None


def _unpaired_text(comparison: Comparison) -> str:
    return f"{counted(comparison.unpaired, 'episode')} failed or without a finished counterpart"


def _json_object(comparison: Comparison) -> dict[str, object]:
    """Return the output of ``--json``.

    It holds the figures that a condition may name, the episodes in which a rate's event happened on one side only,
    and the means of the differences.
    """
    one_sided = {
        label: {"a": list(rate.episodes_a), "b": list(rate.episodes_b)}
        for label, rate in comparison.rates.items()
    }
    values = {name: vars(value) for name, value in comparison.values.items()}
    return {**dict(sorted(comparison.named().items())), "episodes_alone": one_sided, "differences": values}


def _print(console: Console, comparison: Comparison, sides: Sequence[_Side]) -> None:
    for side in sides:
        console.print(str(side), soft_wrap=True)
    _print_rates(console, comparison)
    _print_values(console, comparison)
    _print_one_sided(console, comparison, sides)
    if comparison.unpaired:
        a = f"{comparison.unpaired_a} of A ({comparison.failures_a} failed)"
        b = f"{comparison.unpaired_b} of B ({comparison.failures_b} failed)"
        console.print(f"{_unpaired_text(comparison)}: {a}, {b}", soft_wrap=True)


def _print_rates(console: Console, comparison: Comparison) -> None:
    from advdiff_sumo.cli.sweep_results import rate_text

    pairs, scenes = counted(comparison.pairs, "pair"), counted(comparison.scenes, "seed scene")
    title = f"{pairs} of episodes from {scenes}; rates in %"
    heads = ("", "A", "B", "A only", "B only", "B − A, 95 % bootstrap", "McNemar p")
    table = FittedTable(title, heads)
    for name, rate in comparison.rates.items():
        table.add_row(
            name,
            rate_text(rate.a),
            rate_text(rate.b),
            str(rate.only_a),
            str(rate.only_b),
            f"{100 * rate.change:+.1f} [{100 * rate.low:+.1f}, {100 * rate.high:+.1f}]",
            f"{rate.p:.4f}",
        )
    table.print(console)


def _print_values(console: Console, comparison: Comparison) -> None:
    values = Table(title="means of the differences B − A", title_justify="left")
    for name in ("", "pairs", "mean", "95 % bootstrap"):
        values.add_column(name)
    for name, value in comparison.values.items():
        values.add_row(name, str(value.pairs), f"{value.mean:+.3f}", f"[{value.low:+.3f}, {value.high:+.3f}]")
    if comparison.values:
        console.print(values)


def _print_one_sided(console: Console, comparison: Comparison, sides: Sequence[_Side]) -> None:
    """Print in which episodes the event of the first rate happened on one side only, with a command to repeat one.

    The first rate is that of valid failures if there are verdicts.
    """
    label, rate = next(iter(comparison.rates.items()))
    for side, numbers in zip(sides, (rate.episodes_a, rate.episodes_b), strict=True):
        if numbers:
            listed = ", ".join(map(str, numbers[:_LISTED_EPISODES]))
            listed += ", …" if len(numbers) > _LISTED_EPISODES else ""
            sentence = f"{label} in {side.letter} alone: episodes {listed}; {side.repeat(numbers[0])}"
            console.print(sentence, soft_wrap=True)
