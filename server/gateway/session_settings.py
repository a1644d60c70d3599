"""The settings of the section ``server.limits``: what one client may cost."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from protocol.limits import Limits

_DEFAULT = Limits()


class SessionSettings(BaseModel):
    """What one client may cost, and how long it is waited for.

    Attributes:
        max_message_bytes: size of a frame, of an object that comes in several frames, and of all fragments that wait
            for others [bytes].
        max_objects_per_frame: operations in one frame.
        max_fragments: fragments of one message, and of all that wait for others.
        max_fragmented_messages: messages of which only some fragments have come.
        fragment_timeout_s: a message whose fragments do not come within this time is given up [s].
        max_subscriptions: subscriptions.
        max_publications: topics that it publishes.
        max_offers: services that it offers, and as many actions.
        max_calls_in_flight: calls of services that wait for their answers, and as many goals on actions.
        call_timeout_s: time to answer of a service that it offers, where the caller names none [s].
        max_queued_topic_bytes: messages of topics that wait for a slow client, of which the oldest are dropped [bytes].
        max_queued_request_bytes: calls and goals that wait for a slow client; those beyond fail [bytes].
        max_queued_reply_bytes: answers that wait for a slow client; one that does not take them is disconnected
            [bytes].
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    max_message_bytes: int = Field(default=_DEFAULT.max_message_bytes, ge=65_536, le=100_000_000)
    max_objects_per_frame: int = Field(default=_DEFAULT.max_objects_per_frame, ge=1, le=100_000)
    max_fragments: int = Field(default=_DEFAULT.max_fragments, ge=1, le=1_000_000)
    max_fragmented_messages: int = Field(default=_DEFAULT.max_fragmented_messages, ge=1, le=10_000)
    fragment_timeout_s: float = Field(default=_DEFAULT.fragment_timeout_s, ge=1.0, le=86_400.0)
    max_subscriptions: int = Field(default=_DEFAULT.max_subscriptions, ge=1, le=100_000)
    max_publications: int = Field(default=_DEFAULT.max_publications, ge=1, le=100_000)
    max_offers: int = Field(default=_DEFAULT.max_offers, ge=0, le=100_000)
    max_calls_in_flight: int = Field(default=_DEFAULT.max_calls_in_flight, ge=1, le=100_000)
    call_timeout_s: float = Field(default=_DEFAULT.call_timeout_s, ge=0.1, le=3600.0)
    max_queued_topic_bytes: int = Field(default=_DEFAULT.max_queued_topic_bytes, ge=65_536, le=100_000_000)
    max_queued_request_bytes: int = Field(default=_DEFAULT.max_queued_request_bytes, ge=65_536, le=100_000_000)
    max_queued_reply_bytes: int = Field(default=_DEFAULT.max_queued_reply_bytes, ge=65_536, le=100_000_000)

    def limits(self) -> Limits:
        """The same as the protocol has it."""
        return Limits(**self.model_dump())
