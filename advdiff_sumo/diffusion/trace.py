"""The trace of a roll-out, where the compiled form looks for it."""

from advdiff_sumo.models.trace import Trace as Trace
