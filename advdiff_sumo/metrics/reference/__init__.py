"""Reference drivers: careful and competent drivers after UN Regulation No. 157, in one dimension and on any road."""

from advdiff_sumo.metrics.reference.driver_models import MODELS
from advdiff_sumo.metrics.reference.reference_drive import (
    LOOKBACK_S,
    ReferenceDrive,
    ReferenceDrivers,
    drive_all,
    drive_reference,
)

__all__ = ["LOOKBACK_S", "MODELS", "ReferenceDrive", "ReferenceDrivers", "drive_all", "drive_reference"]
