"""Planted defects: one error each in an otherwise sound planner, to measure what a test can detect."""

from advdiff_sumo.planners.defects.catalogue import DEFECTS, SEVERITIES, DefectKind
from advdiff_sumo.planners.defects.defect_spec import Defect, parse_defect, parse_defects, plant

__all__ = ["DEFECTS", "SEVERITIES", "Defect", "DefectKind", "parse_defect", "parse_defects", "plant"]
