"""Services of the graph: local parts and remote clients offer and call them alike.

A caller gets exactly one response: the provider's, or the reason for which there is none.
"""

import asyncio
import contextlib
import inspect
import logging
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from protocol.dialect import Dialect
from protocol.errors import MessageError
from protocol.messages import ListLimits
from robot.errors import RobotError
from server.errors import NoAnswerError, ServerError, UnsuccessfulError
from server.graph.message_types import MessageTypes
from server.graph.permissions import Node, Rule
from server.graph.providers import CompleteResponse, Hint, PendingRequest, Providers
from server.timers import CallLater

log = logging.getLogger("armbridge.graph")


# Fields of a response message; any of them may be left out. A sentence is the ``message`` of a success.
Answered: TypeAlias = str | Mapping[str, Any] | CompleteResponse

# Offered by a local part: request in, response out, both in ROS 2 spelling.
ServiceFunction: TypeAlias = Callable[[dict[str, Any]], Answered | Awaitable[Answered]]


@dataclass(frozen=True)
class Response:
    """The end of a call."""

    ok: bool
    values: Any
    reason: str = ""


class Call(PendingRequest[Response]):
    """A call that its provider is to end with :meth:`succeed` or :meth:`fail`; only the first end counts."""

    def __init__(
        self,
        service: str,
        type_name: str,
        request: dict[str, Any],
        message_types: MessageTypes,
        caller: Node,
        dialect: Dialect = "ros2",
    ) -> None:
        super().__init__(f"Service {service}", type_name, request, message_types)
        self.service, self.caller, self.dialect = service, caller, dialect
        self.caller_left = False

    def succeed(self, values: object, reason: str = "") -> None:
        """Answer with a response message; what it leaves out gets its default, unless it is a `CompleteResponse`.

        Raises MessageError for values that do not fit: the call has failed, and its caller knows.
        """
        self._end(Response(ok=True, values=self._completed(values), reason=reason))

    def fail(self, values: object) -> None:
        """Answer that it failed, with a sentence or with what the provider gave."""
        self._end(Response(ok=False, values=values))

    def refuse(self, reason: str) -> None:
        """Answer why nothing was done: by ``success`` and ``message``, or as a failure if the response lacks these."""
        response = self._message_types.registry.message(f"{self.type_name}_Response")
        if {"success", "message"} <= {field.name for field in response.fields}:
            log.info("%s: %s", self.service, reason)
            self.succeed({"success": False, "message": reason})
        else:
            self.fail(reason)


def answer(call: Call, function: ServiceFunction) -> None:
    """Have a local part's function answer a call; what it answers at once costs no task."""
    with failure_answered(call):
        values = function(call.request)
        if inspect.isawaitable(values):
            task = asyncio.ensure_future(_answer_later(call, values))
            # Keeps the task alive, which the event loop does not, and ends it when nobody waits any more.
            call.when_ended(lambda _response: task.cancel())
        else:
            call.succeed(_response(values))


async def _answer_later(call: Call, values: Awaitable[Answered]) -> None:
    with failure_answered(call):
        call.succeed(_response(await values))


def _response(values: Answered) -> object:
    return {"success": True, "message": values} if isinstance(values, str) else values


@contextlib.contextmanager
def failure_answered(call: Call) -> Iterator[None]:
    """Answer a call with the reason where the block cannot answer it."""
    try:
        yield
    except NoAnswerError as error:
        call.fail(str(error))
    except UnsuccessfulError as error:
        call.succeed(error.response, str(error))
    except (ServerError, RobotError) as error:
        call.refuse(str(error))
    except Exception:  # a bug in a service must not leave its caller waiting
        log.exception("service %s failed", call.service)
        call.fail(f"Service {call.service} failed inside the server")


# A local part may plan a motion meanwhile; the planners' own deadline is shorter.
LOCAL_TIMEOUT_S = 60.0

# Longest time that a caller may choose to wait.
MAX_TIMEOUT_S = 3600.0

# As for topics: far more than any robot has.
MAX_SERVICES = 10_000

# Limits of requests to parts of the server that name no others.
DEFAULT_LIMITS = ListLimits()


class Services(Providers[Call]):
    """All services."""

    def __init__(self, message_types: MessageTypes, hint: Hint, call_later: CallLater) -> None:
        super().__init__("service", MAX_SERVICES, message_types, hint, call_later)

    def offer(
        self,
        node: Node,
        name: str,
        type_name: str,
        function: ServiceFunction,
        limits: ListLimits = DEFAULT_LIMITS,
        *,
        rule: Rule | None = None,
    ) -> None:
        """Offer a service of a local part; its function returns, or raises a ServerError or RobotError.

        Without a rule it has a client's. Raises GraphError for an unknown type or a name of another part.
        """
        self.offer_calls(node, name, type_name, lambda call: answer(call, function), limits=limits, rule=rule)

    def offer_calls(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[Call], None],
        timeout_s: float = LOCAL_TIMEOUT_S,
        limits: ListLimits | None = DEFAULT_LIMITS,
        *,
        rule: Rule | None = None,
    ) -> None:
        """Offer a service whose calls are handed over one by one, to be ended by `Call.succeed` or `Call.fail`.

        A client takes the place of another client. Its requests have no limits: the server only passes them on.
        """
        self._add(self._claim(node, name, type_name, start, timeout_s, limits), rule)

    def remove(self, node: Node) -> None:
        """Forget a node that has left: its services, and what it has called."""
        for call in self._made.of(node):
            call.caller_left = True
            call.fail("the caller has left")
        self._withdraw_all(node)

    def call(
        self,
        caller: Node,
        name: str,
        arguments: object,
        on_response: Callable[[Response], None],
        timeout_s: float | None = None,
        dialect: Dialect = "ros2",
    ) -> Call | None:
        """Call a service; return the call, or None if it is refused before it begins.

        ``timeout_s`` is 0 for `MAX_TIMEOUT_S`, None for the offer's own [s].
        """
        offer = self._offers.get(name)
        if offer is None:
            # The words of rosbridge_library (internal/services.py), which clients look for.
            on_response(Response(ok=False, values=f"Service {name} {self._missing(name)}"))
            return None
        try:
            request = self._completed(offer, arguments)
        except MessageError as error:
            if (rule := self.rules.get(name)) is None or not rule.at_once:
                on_response(Response(ok=False, values=f"Service {name}: {error}"))
                return None
            # Somebody wants the arm to stop, whatever else the call says.
            request = self._completed(offer, {})
        call = Call(name, offer.type_name, request, self._message_types, caller, dialect)
        bound_s = offer.limit_s if timeout_s is None else min(timeout_s or MAX_TIMEOUT_S, MAX_TIMEOUT_S)
        self._keep(call, offer, call, caller, bound_s, f"Service {name} did not answer in {bound_s:g} s")
        call.when_ended(on_response)
        offer.start(call)
        return call
