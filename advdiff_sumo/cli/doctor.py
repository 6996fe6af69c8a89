"""``advdiff-sumo doctor``: check the installation and run a short self-test."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.text import Text

from advdiff_sumo.cli.terminal import findings_table, terminal
from advdiff_sumo.core.wording import counted

_STYLES = {"ok": "green", "note": "yellow", "problem": "red"}
UNUSABLE = 1


def doctor(
    quick: Annotated[bool, typer.Option("--quick", help="Leave the self-test out.")] = False,
) -> None:
    """Look at the installation and drive for five seconds; exit code 1 if it cannot be used.

    A note is about something optional; a problem keeps runs from working. Both come with what to do.
    """
    from advdiff_sumo.cli.checks import (  # late: not for --help
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
    rows = (
        (Text(finding.state, _STYLES[finding.state]), finding.topic, finding.text) for finding in findings
    )
    console.print(findings_table(rows))
    for finding in findings:
        if finding.hint:
            console.print(Text(f"{finding.topic}: {finding.hint}", style=_STYLES[finding.state]))
    problems = sum(finding.state is CheckState.PROBLEM for finding in findings)
    if problems:
        console.print(Text(f"{counted(problems, 'problem')} to mend", style="red"))
        raise typer.Exit(UNUSABLE)
    console.print(Text("ready to run", style="green"))
