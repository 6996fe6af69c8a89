"""Pure functions of a recorded episode."""
