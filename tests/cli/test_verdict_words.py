"""The counts that ``verdict`` prints, in the singular for one."""

from __future__ import annotations

import io

from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.cli.verdict import _print_counts


def test_one_of_each_is_in_the_singular() -> None:
    sink = io.StringIO()
    row = {
        "end": "horizon",
        "target_collision": False,
        "valid_failure": False,
        "critical": True,
        "offences": 1,
    }
    _print_counts(terminal(file=sink), [row], search=False)
    assert sink.getvalue().splitlines() == [
        "1 episode, 0 collisions of the target: 0 valid failures",
        "1 critical near miss",
        "1 episode in which the target broke a rule",
    ]


def test_failed_episodes_are_counted_as_not_judged() -> None:
    sink = io.StringIO()
    _print_counts(terminal(file=sink), [{"end": "failed", "target_collision": False}], search=False)
    assert sink.getvalue().splitlines() == [
        "0 episodes, 0 collisions of the target: 0 valid failures",
        "0 critical near misses",
        "0 episodes in which the target broke a rule",
        "1 episode failed: not judged",
    ]
