"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

_NO_TIME_LIMITS = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}  # for busy machines
settings.register_profile("desk", **_NO_TIME_LIMITS)
settings.register_profile("ci", derandomize=True, **_NO_TIME_LIMITS)
settings.load_profile("desk")

LONG = (
    "test_bench.py",
    "test_commands.py",
    "test_malformed_files.py",
    "test_misbehaving.py",
    "test_hour.py",
    "test_signals.py",
    "test_converted_nets.py",
    "test_source_readers.py",
    "test_osm.py",
    "test_any_net.py",
    "test_tum_planners.py",
    "test_shipped_networks.py",
    "test_data.py",
    "test_rim.py",
    "test_conflict_areas.py",
    "test_log_windows.py",
    "test_defects.py",
    "test_warmup.py",
    "test_margin.py",
    "test_threads.py",
    "test_train_target.py",
    "test_training_loop.py",
    "test_cpp_planner.py",
    "test_plan_memo.py",
    "test_faults.py",
    "test_remote_faults.py",
    "test_diverse.py",
)
"""Files that take minutes, longest first. They run first, since a long file at the end would leave a worker idle."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of long files first; ``make test`` runs them in that order."""
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


@pytest.fixture(scope="session")
def adv_data() -> Path:
    """Return the folder of real data that ADVDIFF_DATA names; without it, skip the test."""
    setting = os.environ.get("ADVDIFF_DATA")
    if not setting:
        pytest.skip("ADVDIFF_DATA is not set: this test needs the real nets and logs")
    root = Path(setting).resolve()
    if not root.is_dir():
        pytest.skip(f"ADVDIFF_DATA={setting} is no folder")
    return root


@pytest.fixture(scope="session")
def networks() -> Path:
    """Return the folder of the shipped nets."""
    return Path(__file__).resolve().parents[1] / "networks"
