"""Providers of services and actions: one table by name, and the base of requests on their way.

A request is ended once, by its provider, its deadline or its caller's departure; whatever comes later goes nowhere.
"""

import logging
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeAlias, TypeVar

from protocol.errors import InterfaceError, MessageError
from protocol.messages import ListLimits
from protocol.registry import Kind
from server.errors import GraphError
from server.graph.index import Index, TypedNames
from server.graph.message_types import MessageTypes
from server.graph.permissions import Node, Rule
from server.timers import CallLater

log = logging.getLogger("armbridge.graph")

End = TypeVar("End")


@dataclass(frozen=True)
class CompleteResponse:
    """A large response, or result of an action, that is complete and valid already; nobody may change it any more."""

    message: Mapping[str, Any]


class PendingRequest(Generic[End]):
    """Base of calls and goals on their way; the title says what was asked for, as ``Service /name``."""

    # End of the name of its answer's type.
    answered = "Response"

    def __init__(self, title: str, type_name: str, request: dict[str, Any], message_types: MessageTypes) -> None:
        self.title, self.type_name, self.request, self.ended = title, type_name, request, False
        self._message_types = message_types
        self._when_ended: list[Callable[[End], object]] = []

    def when_ended(self, callback: Callable[[End], object]) -> None:
        """Call ``callback`` with the end, in whatever way it comes; callbacks are called in order of registration."""
        self._when_ended.append(callback)

    def fail(self, values: object) -> None:
        """End the request with a sentence, or with what the provider gave."""
        raise NotImplementedError

    def _completed(self, values: object) -> Any:
        """Complete the provider's response or result; raise MessageError if it does not fit, and the request fails."""
        if isinstance(values, CompleteResponse):
            return values.message
        try:
            return self._message_types.complete(f"{self.type_name}_{self.answered}", values)
        except MessageError as error:
            self.fail(f"{self.title} gave a {self.answered.lower()} that does not fit {self.type_name}: {error}")
            raise

    def _end(self, end: End) -> None:
        if self.ended:
            return
        self.ended = True
        # The callbacks lead back to this request: without them it is freed at once, not by the garbage collector.
        callbacks, self._when_ended = self._when_ended, []
        for callback in callbacks:
            try:
                callback(end)
            except Exception:  # an error of one listener must not keep the others from stopping the arm
                log.exception("a listener to the end of a request failed")


ProvidedKind: TypeAlias = Literal["service", "action"]

_TYPE_KINDS: dict[ProvidedKind, Kind] = {"service": "srv", "action": "action"}

_REQUESTS: dict[ProvidedKind, str] = {"service": "Request", "action": "Goal"}

# Returns the end of a sentence about an unknown name: which of the server's own may be meant.
Hint: TypeAlias = Callable[[str, Iterable[str]], str]

AnyRequest = TypeVar("AnyRequest", bound=PendingRequest[Any])


@dataclass(eq=False)
class Provider(Generic[AnyRequest]):
    """A service or an action that a node provides, and the requests on their way to it, the oldest first."""

    node: Node
    name: str
    type_name: str
    start: Callable[[AnyRequest], None]
    limit_s: float
    limits: ListLimits | None = None
    requests: dict[Hashable, AnyRequest] = field(default_factory=dict)


class Providers(Generic[AnyRequest]):
    """All offers of one kind, one a name; base of :class:`Services` and :class:`Actions`."""

    def __init__(
        self, kind: ProvidedKind, limit: int, message_types: MessageTypes, hint: Hint, call_later: CallLater
    ) -> None:
        self.names = TypedNames()
        self.rules: dict[str, Rule] = {}
        self._kind = kind
        self._limit = limit
        self._message_types = message_types
        self._hint = hint
        self._call_later = call_later
        self._offers: dict[str, Provider[AnyRequest]] = {}
        self._by_node: Index[Node, Provider[AnyRequest]] = Index()
        # Requests on their way, by the node that has made them.
        self._made: Index[Node, AnyRequest] = Index()

    def provider(self, name: str) -> Node | None:
        offer = self._offers.get(name)
        return None if offer is None else offer.node

    def _missing(self, name: str) -> str:
        """Return the end of the sentence about a name that nobody offers."""
        own = (offer.name for offer in self._offers.values() if not offer.node.remote)
        return f"does not exist{self._hint(name, own)}"

    def providers_of_type(self, type_name: str) -> set[Node]:
        """Return the nodes that provide something of a type, in the spelling of either dialect."""
        return {self._offers[name].node for name in self.names.of_type(type_name)}

    def nodes(self) -> list[Node]:
        return list(self._by_node)

    def provided_by(self, node: Node) -> list[str]:
        return [offer.name for offer in self._by_node.of(node)]

    def withdraw(self, node: Node, name: str) -> None:
        """End an offer of this node, and the requests on their way; nothing happens where it is not this node's."""
        offer = self._offers.get(name)
        if offer is not None and offer.node is node:
            self._remove(offer)

    def fail_all(self, reason: str) -> None:
        """Fail every request on its way: where the server ends, nothing else would answer it."""
        for request in [each for node in self._made for each in self._made.of(node)]:
            request.fail(reason)

    def _end_requests(self, offer: Provider[AnyRequest]) -> None:
        """End the requests on their way to an offer that has just been withdrawn or replaced."""
        for request in list(offer.requests.values()):
            request.fail(f"{self._kind.capitalize()} {offer.name} was withdrawn by its provider")

    def _claim(
        self,
        node: Node,
        name: str,
        type_name: str,
        start: Callable[[AnyRequest], None],
        limit_s: float,
        limits: ListLimits | None,
    ) -> Provider[AnyRequest]:
        """Check that a node may offer a name, end another client's offer, and return the new one."""
        try:
            canonical = self._message_types.canonical(type_name, _TYPE_KINDS[self._kind])
        except InterfaceError as error:
            raise GraphError(self._kind, name, str(error)) from error
        present = self._offers.get(name)
        if present is not None:
            if present.node is not node and not present.node.remote:
                raise GraphError(self._kind, name, "is offered by the server itself")
            self._remove(present)
        elif len(self._offers) >= self._limit:
            raise GraphError(self._kind, name, f"cannot be added: there are {self._limit} {self._kind}s already")
        return Provider(node, name, canonical, start, limit_s, limits)

    def _add(self, offer: Provider[AnyRequest], rule: Rule | None) -> None:
        self._offers[offer.name] = offer
        self.names.add(offer.name, offer.type_name)
        self._by_node.add(offer.node, offer)
        if rule is not None:
            self.rules[offer.name] = rule

    def _completed(self, offer: Provider[AnyRequest], arguments: object) -> dict[str, Any]:
        """Complete a request; raises MessageError if it does not fit its type or has too long a list."""
        type_name = f"{offer.type_name}_{_REQUESTS[self._kind]}"
        return self._message_types.complete_arguments(type_name, arguments, offer.limits)

    def _keep(
        self, request: AnyRequest, offer: Provider[AnyRequest], key: Hashable, sender: Node, limit_s: float, late: str
    ) -> None:
        """Keep account of a request until it ends, which it does in time: after ``limit_s`` with the sentence."""
        offer.requests[key] = request
        self._made.add(sender, request)
        timer = self._call_later(limit_s, lambda: request.fail(late))

        def forget(_end: object) -> None:
            timer.cancel()
            del offer.requests[key]
            self._made.discard(sender, request)

        request.when_ended(forget)

    def _withdraw_all(self, node: Node) -> None:
        for offer in self._by_node.of(node):
            # The end of one may have ended others.
            if self._offers.get(offer.name) is offer:
                self._remove(offer)

    def _remove(self, offer: Provider[AnyRequest]) -> None:
        del self._offers[offer.name]
        self.names.remove(offer.name)
        self._by_node.discard(offer.node, offer)
        self._end_requests(offer)
