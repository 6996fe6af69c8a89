"""Recognise the names of targets that are planners in separate processes."""

from advdiff_sumo.core.errors import ConfigError

GRPC, EXEC = "grpc://", "exec:"


def is_remote(name: str) -> bool:
    """Return whether the target *name* is ``grpc://HOST:PORT`` or ``exec:COMMAND``."""
    return name.startswith((GRPC, EXEC))


def check_slashes(name: str) -> None:
    """Refuse a gRPC address without its slashes, which would be taken for a class in a module.

    Raises:
        ConfigError: *name* is such an address.
    """
    scheme = GRPC.rstrip("/")
    if name.startswith(scheme) and not name.startswith(GRPC):
        address = name.removeprefix(scheme).lstrip("/") or "localhost:50051"
        raise ConfigError(
            f"target '{name}': a planner's server is written grpc://HOST:PORT; did you mean '{GRPC}{address}'?"
        )
