"""What people look at after a run: the report page and pictures of episodes."""

from advdiff_sumo.report.drawing import figure
from advdiff_sumo.report.page import write_report

__all__ = ["figure", "write_report"]
