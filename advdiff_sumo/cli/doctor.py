"""``advdiff-sumo doctor``: what is installed, what is missing, and whether it drives."""

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
    console.print(
        findings_table((Text(one.state, _STYLES[one.state]), one.topic, one.text) for one in findings)
    )
    for finding in findings:
        if finding.hint:
            console.print(Text(f"{finding.topic}: {finding.hint}", style=_STYLES[finding.state]))
    problems = sum(finding.state is CheckState.PROBLEM for finding in findings)
    if problems:
        console.print(Text(f"{counted(problems, 'problem')} to mend", style="red"))
        raise typer.Exit(UNUSABLE)
    console.print(Text("ready to run", style="green"))
