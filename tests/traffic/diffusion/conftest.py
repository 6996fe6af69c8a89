"""The small networks and the street of ``tests.traffic.small_networks``."""

from __future__ import annotations

from tests.traffic.small_networks import downtown, one_thread, street, uncoupled, weights

__all__ = ["downtown", "one_thread", "street", "uncoupled", "weights"]
