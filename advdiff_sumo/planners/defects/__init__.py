"""Planted defects: one fault each in an otherwise sound planner, to learn what a test can see."""

from advdiff_sumo.planners.defects.catalogue import DEFECTS, SEVERITIES, DefectKind
from advdiff_sumo.planners.defects.defect_spec import Defect, parse_defect, parse_defects, plant

__all__ = ["DEFECTS", "SEVERITIES", "Defect", "DefectKind", "parse_defect", "parse_defects", "plant"]
