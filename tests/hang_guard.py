"""How long a test waits for another process before it takes it for hung; no test may fail because a machine is busy."""

#: Many times what the slowest of them takes on a machine at rest.
HANG_S = 3600.0
