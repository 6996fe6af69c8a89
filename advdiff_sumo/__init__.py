"""Closed-loop adversarial traffic on SUMO: find situations in which a driving planner fails.

::

    import advdiff_sumo as ads

    results = ads.run(net="downtown", target=MyPlanner(), background="diffusion", episodes=20)
    results.summary()
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from advdiff_sumo.api import EpisodeView, Results, convert, load, run, sweep

__all__ = ["EpisodeView", "Results", "__version__", "convert", "load", "run", "sweep"]


def __getattr__(name: str) -> Any:
    """Return a name of the API; it is imported when first used, since it also imports SUMO and plots."""
    if name in __all__:
        import importlib

        value = getattr(importlib.import_module("advdiff_sumo.api"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'advdiff_sumo' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
