"""What a script or a notebook calls; ``import advdiff_sumo as ads`` has all of it."""

from advdiff_sumo.api.episode_view import EpisodeView
from advdiff_sumo.api.result_tables import Results, Summary, load
from advdiff_sumo.api.verbs import convert, run, sweep

__all__ = ["EpisodeView", "Results", "Summary", "convert", "load", "run", "sweep"]
