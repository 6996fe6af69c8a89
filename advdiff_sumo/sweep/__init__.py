"""Sweeps: many episodes, run by workers that may die, with results that are never lost.

The package can be called: ``advdiff_sumo.sweep(…)`` is :func:`advdiff_sumo.api.sweep`, which has the same name.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """A module that can be called like a function."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Run a sweep; see :func:`advdiff_sumo.api.sweep`."""
        return importlib.import_module("advdiff_sumo.api").sweep(*args, **options)


sys.modules[__name__].__class__ = _Callable
