"""What a worker makes of what goes wrong in it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from advdiff_sumo.sweep.tasks import CallTask
from advdiff_sumo.sweep.work import perform


def lacking() -> bytes:
    raise MemoryError("17 GB")


def filling() -> bytes:
    return bytes(torch.empty(10**15))  # four petabytes, more than a process can address


@pytest.mark.parametrize(("call", "words"), [(lacking, "17 GB"), (filling, "can't allocate memory")])
def test_a_worker_without_memory_says_so_whoever_asked_for_it(call: Callable[[], bytes], words: str) -> None:
    failed = perform(CallTask("k", call)).failed
    assert failed is not None
    assert failed.kind == "out_of_memory"
    assert failed.message.startswith("the worker ran out of memory: ")
    assert words in failed.message
    assert "Traceback" in failed.log_tail
