"""Services in one process: a local part and a remote client offer and call them alike.

Whoever calls gets exactly one response: the provider's, or the reason why there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from protocol.dialect import Dialect
from protocol.errors import MessageError
from server.calls import Call, Response, ServiceFunction, answer
from server.interfaces import Interfaces
from server.node import Node
from server.offers import Directory, Offer, Offers
from server.timers import CallLater

# rosbridge_server's default_call_service_timeout, for services of clients.
DEFAULT_TIMEOUT_S = 5.0

# A local part may plan a motion meanwhile; the planners' own deadline is shorter.
LOCAL_TIMEOUT_S = 60.0

# For callers that want to wait for as long as they may.
MAX_TIMEOUT_S = 3600.0

# As for topics: far more than any robot has.
MAX_SERVICES = 10_000


@dataclass(eq=False)
class ServiceOffer(Offer):
    """A service that somebody offers.

    Attributes:
        start: gets each call.
        timeout_s: how long a call may take that names no time of its own [s].
        calls: those in flight, each with its caller.
    """

    start: Callable[[Call], None]
    timeout_s: float
    calls: dict[Call, Node] = field(default_factory=dict)


class Services(Directory[ServiceOffer]):
    """All services.

    Args:
        interfaces: service types.
        call_later: does something after a delay.
    """

    def __init__(self, interfaces: Interfaces, call_later: CallLater) -> None:
        super().__init__(Offers("service", MAX_SERVICES, interfaces, _fail_calls))
        self._interfaces = interfaces
        self._call_later = call_later

    def offer(
        self, node: Node, name: str, type_name: str, function: ServiceFunction, timeout_s: float = LOCAL_TIMEOUT_S
    ) -> None:
        """Offer a service of a local part.

        Args:
            node: who offers it.
            name: fully qualified name.
            type_name: the service's type.
            function: gets the complete request and returns the response, at once or when awaited. It raises
                ServiceError with the reason when it cannot.
            timeout_s: how long a call may take that names no time of its own [s].

        Raises:
            GraphError: the type is unknown, or the name is taken by another part of the server.
        """
        self.offer_calls(node, name, type_name, lambda call: answer(call, function), timeout_s)

    def offer_calls(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[Call], None],
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Offer a service whose calls are handed over one by one, to be ended by `Call.succeed` or `Call.fail`.

        A client takes the place of a client that offered the service before.

        Raises:
            GraphError: the type is unknown, or the name is taken by a part of the server.
        """
        canonical = self._offers.claim(node, name, type_name)
        self._offers.add(ServiceOffer(node, name, canonical, start, timeout_s))

    def withdraw(self, node: Node, name: str) -> None:
        """End an offer of this node; calls in flight fail. Nothing happens when it offers no such service."""
        self._offers.withdraw(node, name)

    def remove(self, node: Node) -> None:
        """Forget a node that has left: its services, and what it has called."""
        for offer in self._offers.all():
            for call in [call for call, caller in offer.calls.items() if caller is node]:
                call.fail("the caller has left")
            self._offers.withdraw(node, offer.name)

    def call(
        self,
        caller: Node,
        name: str,
        arguments: object,
        on_response: Callable[[Response], None],
        timeout_s: float | None = None,
        dialect: Dialect = "ros2",
    ) -> None:
        """Call a service.

        Args:
            caller: who calls.
            name: fully qualified name.
            arguments: the request, as in `Interfaces.complete_arguments`.
            on_response: called once, perhaps before this returns.
            timeout_s: how long to wait [s], 0 for `MAX_TIMEOUT_S`, None for what the service's offer says.
            dialect: which generation of ROS the caller wants to be told about.
        """
        offer = self._offers.get(name)
        if offer is None:
            # The words of rosbridge_library (internal/services.py), which clients look for.
            on_response(Response(ok=False, values=f"Service {name} does not exist"))
            return
        try:
            request = self._interfaces.complete_arguments(f"{offer.type_name}_Request", arguments)
        except MessageError as error:
            on_response(Response(ok=False, values=f"Service {name}: {error}"))
            return
        call = Call(name, offer.type_name, request, self._interfaces, caller, dialect)
        self._bound(call, offer, caller, timeout_s)
        call.when_ended(on_response)
        offer.start(call)

    def _bound(self, call: Call, offer: ServiceOffer, caller: Node, timeout_s: float | None) -> None:
        """Keep account of a call until it ends, which it does in time."""
        bound_s = offer.timeout_s if timeout_s is None else min(timeout_s or MAX_TIMEOUT_S, MAX_TIMEOUT_S)
        offer.calls[call] = caller
        call.when_ended(lambda _response: offer.calls.pop(call))
        timer = self._call_later(bound_s, lambda: call.fail(f"Service {call.service} did not answer in {bound_s:g} s"))
        call.when_ended(lambda _response: timer.cancel())


def _fail_calls(offer: ServiceOffer) -> None:
    for call in list(offer.calls):
        call.fail(f"Service {offer.name} was withdrawn by its provider")
