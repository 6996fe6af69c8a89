"""Options and output that ``check-planner`` and ``check-policy`` have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer
from rich.text import Text

from advdiff_sumo.cli.terminal import findings_table, terminal

if TYPE_CHECKING:
    from advdiff_sumo.experiments.check_results import CheckResult

FAILS = 1
_STATES = {True: Text("ok", style="green"), False: Text("fails", style="red"), None: Text("–")}

Net: TypeAlias = Annotated[
    str, typer.Option(help="SUMO net, or a shipped one: downtown, downtown-left, downtown-people, motorway.")
]
Episodes: TypeAlias = Annotated[int, typer.Option(min=1, help="Drives in SUMO's traffic.")]
Horizon: TypeAlias = Annotated[float, typer.Option(min=1.0, help="Their length in seconds.")]
Timeout: TypeAlias = Annotated[
    float, typer.Option(min=1.0, help="Longest time for all checks, in seconds of the clock.")
]
TIMEOUT_S = 900.0


def tell_checks(name: str, verdicts: Sequence[CheckResult]) -> None:
    """Print *verdicts* on the planner or policy *name*; exit with code 1 if a check fails."""
    console = terminal(highlight=False, soft_wrap=True)
    console.print(findings_table((_STATES[x.ok], x.name, x.detail) for x in verdicts))
    failed = sum(x.ok is False for x in verdicts)
    if failed:
        console.print(Text(f"{name}: {failed} of {len(verdicts)} checks fail", style="red"))
        raise typer.Exit(FAILS)
    console.print(Text(f"{name} keeps the contract", style="green"))
