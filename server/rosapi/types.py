"""What types look like: the texts and TypeDefs of messages and of the members of services."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from protocol.dialect import Dialect
from protocol.errors import InterfaceError
from protocol.interface_text import full_text, typedefs
from protocol.registry import Registry
from server.errors import ServiceError
from server.graph.topics import Graph
from server.rosapi.question import Answers, Question

# Of all texts in one answer: those of 4000 types of average length, or of 380 of the longest. Without a bound, a client
# that advertises thousands of topics would make every answer a burden on everybody.
MAX_TEXTS_CHARACTERS = 4 << 20


class Types:
    """Answers questions about types, as the caller's generation of ROS declares them.

    Args:
        graph: topics.
        registry: types.
    """

    def __init__(self, graph: Graph, registry: Registry) -> None:
        self._graph = graph
        self._registry = registry
        # Foxglove asks for the texts of all topics every three seconds; there are no more types than the tables hold.
        self._texts: dict[tuple[str, Dialect], str] = {}
        self.answers: Answers = {
            "topics_and_raw_types": ("rosapi_msgs/srv/TopicsAndRawTypes", self._topics_and_raw_types),
            "message_details": ("rosapi_msgs/srv/MessageDetails", self._message_details),
            "service_request_details": ("rosapi_msgs/srv/ServiceRequestDetails", self._request_details),
            "service_response_details": ("rosapi_msgs/srv/ServiceResponseDetails", self._response_details),
        }

    def _topics_and_raw_types(self, asked: Question) -> dict[str, Any]:
        types = self._graph.topic_types()
        texts = _within_bound(self._full_text(type_name, asked.dialect) for type_name in types.values())
        return {"topics": list(types), "types": asked.spell_all(types.values()), "typedefs_full_text": texts}

    def _full_text(self, type_name: str, dialect: Dialect) -> str:
        text = self._texts.get((type_name, dialect))
        if text is None:
            try:
                text = self._texts[type_name, dialect] = full_text(self._registry, type_name, dialect)
            except InterfaceError:
                # A type that is relayed without being known.
                return ""
        return text

    def _message_details(self, asked: Question) -> dict[str, Any]:
        return self._details(asked, lambda name: name)

    def _request_details(self, asked: Question) -> dict[str, Any]:
        return self._details(asked, lambda name: f"{self._registry.canonical(name, 'srv')}_Request")

    def _response_details(self, asked: Question) -> dict[str, Any]:
        return self._details(asked, lambda name: f"{self._registry.canonical(name, 'srv')}_Response")

    def _details(self, asked: Question, message_of: Callable[[str], str]) -> dict[str, Any]:
        """Return the TypeDefs of the message that belongs to the type in question."""
        try:
            return {"typedefs": typedefs(self._registry, message_of(asked.request["type"]), asked.dialect)}
        except InterfaceError as error:
            raise ServiceError(str(error)) from error


def _within_bound(texts: Iterable[str]) -> list[str]:
    """Leave the texts empty that are too much."""
    kept = []
    left = MAX_TEXTS_CHARACTERS
    for text in texts:
        kept.append(text if len(text) <= left else "")
        left -= len(kept[-1])
    return kept
