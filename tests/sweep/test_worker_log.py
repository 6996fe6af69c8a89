"""What is kept of a worker's output."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.sweep.worker_sandbox import tail_of

STUCK = 'Timeout (0:05:00)!\nThread 0x01 (most recent call first):\n  File "a.py", line 3 in plan\n'
CRASHED = 'Fatal Python error: Segmentation fault\n\nCurrent thread 0x01:\n  File "a.py", line 3 in plan\n'


def kept(folder: Path, text: str) -> str:
    log = folder / "log"
    log.write_text(text, encoding="utf-8")
    return tail_of(log)


def test_a_short_log_is_kept_and_of_a_long_one_the_end(tmp_path: Path) -> None:
    assert kept(tmp_path, "thinking\n") == "thinking"
    much = kept(tmp_path, "".join(f"line {number}\n" for number in range(2000)))
    first, _, rest = much.partition("\n")
    assert first == "… (of what was printed the last 4000 characters)"
    assert rest.endswith("line 1998\nline 1999")
    assert len(rest) <= 4000
    assert tail_of(tmp_path / "none") == ""


@pytest.mark.parametrize("stack", [STUCK, CRASHED])
def test_of_a_stack_the_beginning_is_kept_with_the_lines_before(tmp_path: Path, stack: str) -> None:
    tail = kept(tmp_path, "before\n" * 2000 + stack + "x" * 20_000)
    assert stack.strip() in tail
    assert "before\nbefore\n" in tail


def test_a_planners_own_output_is_no_stack(tmp_path: Path) -> None:
    said = "requests.Timeout (5 s)\n" + "after\n" * 10
    assert kept(tmp_path, said) == said.strip()
