"""Which targets are planners in processes of their own."""

GRPC, EXEC = "grpc://", "exec:"


def is_remote(name: str) -> bool:
    """Return whether the target *name* is ``grpc://HOST:PORT`` or ``exec:COMMAND``."""
    return name.startswith((GRPC, EXEC))
