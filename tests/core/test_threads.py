"""One thread inside the block, the previous number of threads after it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from threadpoolctl import ThreadpoolController

from advdiff_sumo.core.threads import one_thread


def _counts() -> tuple[int, list[int]]:
    np.linalg.norm(np.ones(3))  # numpy's library is loaded
    return torch.get_num_threads(), [
        one["num_threads"] for one in ThreadpoolController().select(user_api="blas").info()
    ]


def test_one_thread_inside_and_the_previous_number_after() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        outside = _counts()
        with one_thread():
            with one_thread():
                assert _counts() == (1, [1] * len(outside[1]))
            assert _counts() == (1, [1] * len(outside[1]))
        assert _counts() == outside
        assert outside[0] == 3
    finally:
        torch.set_num_threads(before)


def test_threads_come_back_after_an_exception() -> None:
    before = _counts()

    @one_thread()
    def fails() -> None:
        assert torch.get_num_threads() == 1
        raise KeyError("x")

    with pytest.raises(KeyError):
        fails()
    assert _counts() == before
