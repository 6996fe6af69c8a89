"""What people look at after a run: the report page, pictures and films of episodes."""

from advdiff_sumo.report.drawing import figure
from advdiff_sumo.report.page import write_report
from advdiff_sumo.report.strip import film_strip
from advdiff_sumo.report.video import video

__all__ = ["figure", "film_strip", "video", "write_report"]
