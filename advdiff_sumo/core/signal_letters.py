"""SUMO's letters for what the signal of a link shows, and sets of those that ask the same of a driver.

As in https://sumo.dlr.de/docs/Simulation/Traffic_Lights.html#signal_state_definitions. Sets, not strings: the empty
letter, of a link without a signal or with one that is not known, is in none of them.
"""

from __future__ import annotations

from typing import Final

PLAIN_RED: Final = "r"
"""Nobody enters."""
RED_YELLOW: Final = "u"
"""Still red, green comes next."""
PLAIN_YELLOW: Final = "y"
"""Red comes next; who goes on gives way as the net says."""
PRIORITY_YELLOW: Final = "Y"
"""The same, and who goes on has the right of way."""
YIELDING_GREEN: Final = "g"
"""Who has it gives way as the net says."""
PROTECTED_GREEN: Final = "G"
"""Who has it gives way to nobody."""
STOP_THEN_YIELD: Final = "s"
"""Green arrow to the right beside red: stop first, then give way."""
BLINKING: Final = "o"
"""Out of order, blinking: who comes gives way as the net says."""
SWITCHED_OFF: Final = "O"
"""Out of order, dark: who comes has the right of way."""

RED: Final = frozenset((PLAIN_RED, RED_YELLOW))
YELLOW: Final = frozenset((PLAIN_YELLOW, PRIORITY_YELLOW))
GREEN: Final = frozenset((YIELDING_GREEN, PROTECTED_GREEN))
