"""SUMO's letters for the signal state of a link, and sets of those with the same meaning for a driver.

As in https://sumo.dlr.de/docs/Simulation/Traffic_Lights.html#signal_state_definitions. They are sets, not strings, so
that the empty letter, of a link without a signal or with an unknown one, is in none of them.
"""

from __future__ import annotations

from typing import Final

PLAIN_RED: Final = "r"
"""Vehicles must not enter."""
RED_YELLOW: Final = "u"
"""Still red; green is next."""
PLAIN_YELLOW: Final = "y"
"""Red is next; a vehicle that enters gives way according to the net."""
PRIORITY_YELLOW: Final = "Y"
"""Red is next; a vehicle that enters has the right of way."""
YIELDING_GREEN: Final = "g"
"""A vehicle that enters gives way according to the net."""
PROTECTED_GREEN: Final = "G"
"""A vehicle that enters has the right of way."""
STOP_THEN_YIELD: Final = "s"
"""Green arrow to the right beside red: stop first, then give way."""
BLINKING: Final = "o"
"""Out of order, blinking: vehicles give way according to the net."""
SWITCHED_OFF: Final = "O"
"""Out of order, dark: a vehicle that enters has the right of way."""

RED: Final = frozenset((PLAIN_RED, RED_YELLOW))
YELLOW: Final = frozenset((PLAIN_YELLOW, PRIORITY_YELLOW))
GREEN: Final = frozenset((YIELDING_GREEN, PROTECTED_GREEN))
