"""One call of a service on its way, from the request to its one response."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import logging
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from protocol.dialect import Dialect
from protocol.errors import MessageError
from server.errors import ServiceError
from server.interfaces import Interfaces
from server.node import Node
from server.pending import Pending

log = logging.getLogger("armbridge.graph")

# Offered by a local part: request in, response out, both in ROS 2 spelling.
ServiceFunction: TypeAlias = Callable[[dict[str, Any]], Mapping[str, Any] | Awaitable[Mapping[str, Any]]]


@dataclass(frozen=True)
class Response:
    """The end of a call.

    Attributes:
        ok: whether the service succeeded.
        values: the complete response message; of a call that failed a sentence, or what the provider gave.
    """

    ok: bool
    values: Any


class Call(Pending[Response]):
    """A call that its provider is to end with :meth:`succeed` or :meth:`fail`; only the first end counts.

    Args:
        service: fully qualified name.
        type_name: canonical name of the service's type.
        request: the complete request.
        interfaces: to complete the response.
        caller: who calls.
        dialect: which generation of ROS the caller wants to be told about; messages are in ROS 2 spelling all the same.

    Attributes:
        service: as given.
        type_name: as given.
        request: as given.
        caller: as given.
        dialect: as given.
    """

    def __init__(
        self,
        service: str,
        type_name: str,
        request: dict[str, Any],
        interfaces: Interfaces,
        caller: Node,
        dialect: Dialect = "ros2",
    ) -> None:
        super().__init__()
        self.service = service
        self.type_name = type_name
        self.request = request
        self.caller = caller
        self.dialect = dialect
        self._interfaces = interfaces

    def succeed(self, values: object) -> None:
        """Answer with a response message; what it leaves out gets its default.

        Raises:
            MessageError: the values do not fit the service's type; the caller has been told that the call failed.
        """
        try:
            completed = self._interfaces.complete(f"{self.type_name}_Response", values)
        except MessageError as error:
            self.fail(f"Service {self.service} gave a response that does not fit {self.type_name}: {error}")
            raise
        self._end(Response(ok=True, values=completed))

    def succeed_as_it_is(self, response: Mapping[str, Any]) -> None:
        """Answer with a response message that is complete and valid already.

        For a large one of the server's own, of which most has been told before. Nobody may change it from here on.
        """
        self._end(Response(ok=True, values=response))

    def fail(self, values: object) -> None:
        """Answer that it failed, with a sentence or with what the provider gave."""
        self._end(Response(ok=False, values=values))


def answer(call: Call, function: ServiceFunction) -> None:
    """Have a local part's function answer a call; what it answers at once costs no task."""
    with _failure_told(call):
        values = function(call.request)
        if inspect.isawaitable(values):
            task = asyncio.ensure_future(_answer_later(call, values))
            # Keeps the task alive, which the event loop does not, and ends it when nobody waits any more.
            call.when_ended(lambda _response: task.cancel())
        else:
            call.succeed(values)


async def _answer_later(call: Call, values: Awaitable[Mapping[str, Any]]) -> None:
    with _failure_told(call):
        call.succeed(await values)


@contextlib.contextmanager
def _failure_told(call: Call) -> Iterator[None]:
    try:
        yield
    except ServiceError as error:
        call.fail(str(error))
    except Exception:  # a bug in a service must not leave its caller waiting
        log.exception("service %s failed", call.service)
        call.fail(f"Service {call.service} failed inside the server")
