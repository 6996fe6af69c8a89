"""The figures of tools/bench_sweep.py, on known memory values."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import pytest

from tests.test_docs import ROOT


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("bench_sweep", ROOT / "tools" / "bench_sweep.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "bench_sweep", module)
    spec.loader.exec_module(module)
    return module


def rows(worker: int, rss_mb: list[float]) -> list[dict[str, float]]:
    return [{"worker": worker, "episode": k, "rss_mb": mb, "peak_mb": mb} for k, mb in enumerate(rss_mb)]


def test_growth_is_measured_after_the_first_episodes(bench: ModuleType) -> None:
    """The first worker grows for 50 episodes and then stays; the second grows by 0.1 MB an episode."""
    steady = [200.0 + 4.0 * min(k, 50) for k in range(150)]
    leaking = [400.0 + 0.1 * k for k in range(150)]
    first, second = bench.workers_of(rows(7, steady) + rows(9, leaking))
    assert first.growth_mb == pytest.approx(0.0, abs=1e-6)
    assert second.growth_mb == pytest.approx(100.0)
    assert bench.missed([first], 1.9) == []
    assert bench.missed([first, second], 1.5) == ["growth: not within 20", "rate: not within 1.8"]
    assert "peak: not within 1200" in bench.missed(bench.workers_of(rows(1, [1300.0])), 2.0)


def test_growth_is_unknown_after_few_episodes(bench: ModuleType) -> None:
    (worker,) = bench.workers_of(rows(3, [100.0 + k for k in range(60)]))
    assert worker.growth_mb is None
    assert bench.missed([worker], 2.0) == []
