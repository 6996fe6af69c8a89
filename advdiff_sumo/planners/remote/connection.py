"""Call a planner's server; each call has a deadline, and each fault becomes a typed failure."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # else gRPC writes to standard error; read at its import

import grpc
from google.protobuf.message import DecodeError

from advdiff_sumo.core.errors import (
    EpisodeFailure,
    OutOfMemoryFailure,
    PlannerCrashedError,
    PlannerError,
    PlannerTimeoutError,
    PlanRefusedError,
)
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.planner_server import TRACE_KEY

_RECONNECT = (
    ("grpc.initial_reconnect_backoff_ms", 50),
    ("grpc.min_reconnect_backoff_ms", 50),
    ("grpc.max_reconnect_backoff_ms", 500),
)

_UNREADABLE = object()
_OWN_DEADLINE = "deadline exceeded"
"""Beginning of gRPC's error for a deadline of this side, in lower case."""
_TOO_LARGE = "message larger than max"
"""Part of gRPC's error for a message that exceeds the receiver's limit, by default 4 MB."""


class PlannerSideError(Exception):
    """Cause of a failure: the traceback, or the output, of the planner's own process."""


def _parser_of(message: Any) -> Callable[[bytes], Any]:
    """Return a function that parses *message*; it returns ``_UNREADABLE`` for damaged bytes.

    gRPC itself would report them as an error of the planner.
    """

    def read(content: bytes) -> Any:
        try:
            return message.FromString(content)
        except DecodeError:
            return _UNREADABLE

    return read


class Connection:
    """One channel to one server.

    Attributes:
        who: name of the target in error messages.
    """

    def __init__(self, address: str, who: str) -> None:
        """Open the channel; nothing is sent before the first call."""
        self.who = who
        self._channel = grpc.insecure_channel(address, options=(*messages.CHANNEL_OPTIONS, *_RECONNECT))
        self._calls = {
            name: self._channel.unary_unary(
                f"/{messages.SERVICE}/{name}",
                request_serializer=request.SerializeToString,
                response_deserializer=_parser_of(response),
            )
            for name, (request, response) in messages.CALLS.items()
        }

    def call(self, name: str, request: Any, timeout_s: float, wait: bool = False) -> Any:
        """Return the server's response.

        Args:
            name: name of the call.
            request: its message.
            timeout_s: deadline.
            wait: whether to keep trying until the deadline if the server cannot be reached yet.

        Raises:
            EpisodeFailure: a subclass by the kind of fault.
        """
        if wait:
            self._wait(name, timeout_s)
        try:
            response = self._calls[name](request, timeout=timeout_s)
        except grpc.RpcError as error:
            failure = self._failure(name, error, timeout_s)
            trace = dict(error.trailing_metadata() or ()).get(TRACE_KEY, b"")
            raise failure from (PlannerSideError(trace.decode(errors="replace")) if trace else None)
        if response is _UNREADABLE:
            raise self._unreadable(name)
        return response

    def _wait(self, name: str, timeout_s: float) -> None:
        """Wait until a server accepts the channel.

        Raises:
            PlannerCrashedError: none does within *timeout_s*.
        """
        try:
            grpc.channel_ready_future(self._channel).result(timeout_s)
        except grpc.FutureTimeoutError:
            raise PlannerCrashedError(
                f"{self.who}: no server answered {name} within {timeout_s:g} s"
            ) from None

    def _unreadable(self, name: str) -> EpisodeFailure:
        """Return the failure for a response that cannot be parsed."""
        kind = PlanRefusedError if name == "MakePlan" else PlannerError
        form = f"{messages.CALLS[name][1].DESCRIPTOR.name} of planner.proto"
        return kind(
            f"{self.who} answered {name} with bytes that are no {form}; build its server from the file that "
            "`advdiff-sumo planner-kit` writes"
        )

    def _failure(self, name: str, error: Any, timeout_s: float) -> EpisodeFailure:
        """Return the failure for an error of gRPC."""
        code, details = error.code(), " ".join((error.details() or "").split())
        if code is grpc.StatusCode.DEADLINE_EXCEEDED and details.lower().startswith(_OWN_DEADLINE):
            return PlannerTimeoutError(f"{self.who} did not answer {name} within {timeout_s:g} s")
        if code is grpc.StatusCode.RESOURCE_EXHAUSTED and _TOO_LARGE in details:
            return PlannerError(
                f"{self.who}: its server takes no message as large as that of {name} ({details}); lift its limit "
                "(SetMaxReceiveMessageSize(-1) in C++, the option grpc.max_receive_message_length elsewhere)"
            )
        if code is grpc.StatusCode.RESOURCE_EXHAUSTED:
            return OutOfMemoryFailure(f"{self.who} ran out of memory: {details}")
        if code is grpc.StatusCode.INVALID_ARGUMENT:
            return PlanRefusedError(f"{self.who}: {details}")
        if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED):
            reason = (
                f" ({details})" if details and name != "Describe" else ""
            )  # there gRPC tells of each address
            return PlannerCrashedError(f"{self.who}: no server answered {name}{reason}")
        if code is grpc.StatusCode.INTERNAL:
            return PlannerError(f"{self.who} raised {details}")
        return PlannerError(f"{self.who} refused {name}: {code.name} {details}")

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()
