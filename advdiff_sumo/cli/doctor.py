"""``advdiff-sumo doctor``: what is installed, what is missing, and whether it drives."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from advdiff_sumo.cli.terminal import counted, terminal

_STYLES = {"ok": "green", "note": "yellow", "problem": "red"}
UNUSABLE = 1


def doctor(
    quick: Annotated[bool, typer.Option("--quick", help="Leave the self-test out.")] = False,
) -> None:
    """Look at the installation and drive for five seconds; exit code 1 if it cannot be used.

    A note is about something optional; a problem keeps runs from working. Both come with what to do.
    """
    from advdiff_sumo.cli.checks import (  # late: --help needs none of it
        CHECKS,
        CheckFinding,
        CheckState,
        self_test,
    )

    console = terminal(highlight=False, soft_wrap=True)
    findings: list[CheckFinding] = []
    for check in CHECKS:
        if not (quick and check is self_test):
            findings.extend(check())
    table = Table(show_header=False, box=None, padding=(0, 1))
    for _ in range(2):
        table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        table.add_row(Text(finding.state, style=_STYLES[finding.state]), finding.topic, Text(finding.text))
    console.print(table)
    for finding in findings:
        if finding.hint:
            console.print(Text(f"{finding.topic}: {finding.hint}", style=_STYLES[finding.state]))
    problems = sum(finding.state is CheckState.PROBLEM for finding in findings)
    if problems:
        console.print(Text(f"{counted(problems, 'problem')} to mend", style="red"))
        raise typer.Exit(UNUSABLE)
    console.print(Text("ready to run", style="green"))
