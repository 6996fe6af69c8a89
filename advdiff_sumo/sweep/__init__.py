"""Sweeps: many episodes over workers that may die, with results that survive.

The package can be called: ``advdiff_sumo.sweep(…)`` is :func:`advdiff_sumo.api.sweep`, whose name it shares.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """A module that is a function, too."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Run a sweep; see :func:`advdiff_sumo.api.sweep`."""
        return importlib.import_module("advdiff_sumo.api").sweep(*args, **options)


sys.modules[__name__].__class__ = _Callable
