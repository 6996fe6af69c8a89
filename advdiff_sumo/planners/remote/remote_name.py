"""Which targets are planners in processes of their own."""

from advdiff_sumo.core.errors import ConfigError

GRPC, EXEC = "grpc://", "exec:"


def is_remote(name: str) -> bool:
    """Return whether the target *name* is ``grpc://HOST:PORT`` or ``exec:COMMAND``."""
    return name.startswith((GRPC, EXEC))


def check_slashes(name: str) -> None:
    """Refuse an address without its slashes, which would be taken for a class of a module.

    Raises:
        ConfigError: it is one.
    """
    scheme = GRPC.rstrip("/")
    if name.startswith(scheme) and not name.startswith(GRPC):
        address = name.removeprefix(scheme).lstrip("/") or "localhost:50051"
        raise ConfigError(
            f"target '{name}': a planner's server is written grpc://HOST:PORT; did you mean '{GRPC}{address}'?"
        )
