"""HD maps to SUMO nets: parse, repair, lay out, write, check."""

from advdiff_sumo.maps.convert.convert import ConversionResult, convert_map, convert_source

__all__ = ["ConversionResult", "convert_map", "convert_source"]
