"""The checks of a planner in a process of its own, so that one that crashes, hangs or leaves is told so."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plug_in_source import crashed_at
from advdiff_sumo.experiments.planner_check import CheckResult, Extent, check_target
from advdiff_sumo.sweep.executors import ProcessExecutor, outcome_of
from advdiff_sumo.sweep.tasks import CallTask, WorkerLimits

LASTS = "comes to its end"


def check_in_worker(
    name: str, options: Mapping[str, Any], extent: Extent, limits: WorkerLimits, hear: Callable[[str], None]
) -> list[CheckResult]:
    """Return what :func:`check_target` returns, or one verdict on a planner that ends the process or never comes back.

    Args:
        name: as of ``--target``.
        options: of the planner.
        extent: how much is tried.
        limits: of the worker.
        hear: called with what the planner printed.

    Raises:
        InputError: there is no such planner, or it cannot be made.
    """
    with ProcessExecutor(1, limits) as executor:
        outcome = outcome_of(CallTask("check", partial(_verdicts, name, dict(options), extent)), executor)
    if outcome.said:
        hear(outcome.said)
    failed = outcome.failed
    if failed is None:
        return [CheckResult(**content) for content in json.loads(outcome.product[0])]
    if failed.is_unusable:
        raise ConfigError(failed.message)
    return [CheckResult(LASTS, False, f"{failed.message}{crashed_at(failed.log_tail)}")]


def _verdicts(name: str, options: Mapping[str, Any], extent: Extent) -> bytes:
    verdicts = [asdict(verdict) for verdict in check_target(name, options, extent)]
    return json.dumps(verdicts).encode()
