"""Functions and classes for scripts and notebooks; ``import advdiff_sumo as ads`` has all of them."""

from advdiff_sumo.api.episode_view import EpisodeView
from advdiff_sumo.api.result_tables import Results, Summary, load
from advdiff_sumo.api.verbs import convert, run, sweep

__all__ = ["EpisodeView", "Results", "Summary", "convert", "load", "run", "sweep"]
