"""Operations: what a client can ask for, one model per op of rosbridge v2.

A row of `OPERATIONS` is all that an op needs to be understood. A field's description says what it takes;
refusals quote it. Fields that are not listed are ignored, as rosbridge ignores them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from protocol.errors import OperationError, describe

# ROS 2 middleware takes no longer names of topics and types.
MAX_NAME_CHARACTERS = 255

# Clients use UUIDs or topic names with a prefix; the id of every subscription is kept.
MAX_ID_CHARACTERS = 512

Name: TypeAlias = Annotated[
    str,
    Field(
        min_length=1,
        max_length=MAX_NAME_CHARACTERS,
        description=f"text of 1 to {MAX_NAME_CHARACTERS} characters",
    ),
]
OptionalName: TypeAlias = Annotated[
    Annotated[str, Field(min_length=1, max_length=MAX_NAME_CHARACTERS)] | None,
    Field(description=f"text of 1 to {MAX_NAME_CHARACTERS} characters"),
]
OperationId: TypeAlias = Annotated[
    Annotated[str, Field(max_length=MAX_ID_CHARACTERS)] | int | None,
    Field(description=f"text of up to {MAX_ID_CHARACTERS} characters, an integer or null"),
]
Count: TypeAlias = Annotated[int, Field(ge=0, description="an integer >= 0")]
# rosbridge refuses fractions here, and clients that compute the rate then get nothing.
Milliseconds: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False, description="milliseconds >= 0")]
# ros-sharp always sends 2147483647, so there is no upper bound.
FragmentSize: TypeAlias = Annotated[
    Annotated[int, Field(gt=0)] | None, Field(description="a number of characters > 0, or null")
]
Flag: TypeAlias = Annotated[bool, Field(description="true or false")]
JsonObject: TypeAlias = Annotated[dict[str, Any], Field(description="an object")]
Qos: TypeAlias = Annotated[dict[str, Any] | None, Field(description="an object or null")]
Compression: TypeAlias = Annotated[
    Literal["none", "png", "cbor", "cbor-raw"], Field(description="none, png, cbor or cbor-raw")
]


class Operation(BaseModel):
    """What all operations have in common.

    Attributes:
        op: the operation's name.
        id: the client's own mark, returned as it came.
    """

    # Strict: text is no number and 1 is no truth value, or "false" would latch a topic.
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")

    op: str
    id: OperationId = None


class Advertise(Operation):
    """Register the client as a publisher of a topic.

    Attributes:
        latch: keep the last message for clients that subscribe later.
        queue_size: accepted for the sake of ROS clients; there is no queue on the way in.
        qos: ROS 2 quality of service, accepted and not applied.
    """

    op: Literal["advertise"] = "advertise"
    topic: Name
    type: Name
    latch: Flag = False
    queue_size: Count = 100
    qos: Qos = None


class Unadvertise(Operation):
    """Withdraw one registration of a publisher (by id), or all of this client on the topic (no id)."""

    op: Literal["unadvertise"] = "unadvertise"
    topic: Name


class Publish(Operation):
    """Publish one message.

    Attributes:
        msg: the message, in any spelling; fields left out get their defaults.
        type: the message's type, which some clients name; it need not be given.
        latch: as in `Advertise`, for a topic that was not advertised.
        queue_size: as in `Advertise`.
    """

    op: Literal["publish"] = "publish"
    topic: Name
    msg: JsonObject = Field(default_factory=dict)
    type: OptionalName = None
    latch: Flag = False
    queue_size: Count = 100


class Subscribe(Operation):
    """Ask for the messages of a topic.

    Attributes:
        type: the messages' type, None for the topic's established type.
        throttle_rate: least time between two messages [ms].
        queue_length: messages kept for the throttle to let through, 0 for none.
        fragment_size: greatest length of an outgoing frame [characters].
        compression: the encoding asked for.
        qos: ROS 2 quality of service, accepted and not applied.
    """

    op: Literal["subscribe"] = "subscribe"
    topic: Name
    type: OptionalName = None
    throttle_rate: Milliseconds = 0.0
    queue_length: Count = 0
    fragment_size: FragmentSize = None
    compression: Compression = "none"
    qos: Qos = None


class Unsubscribe(Operation):
    """Withdraw one subscription (by id), or all of this client on the topic (no id)."""

    op: Literal["unsubscribe"] = "unsubscribe"
    topic: Name


OPERATIONS: dict[str, type[Operation]] = {
    "advertise": Advertise,
    "unadvertise": Unadvertise,
    "publish": Publish,
    "subscribe": Subscribe,
    "unsubscribe": Unsubscribe,
}


def parse(value: object) -> Operation:
    """Read one decoded frame as an operation.

    Raises:
        OperationError: no object, no op, an unknown op, or a field that is missing or senseless.
    """
    if not isinstance(value, dict):
        raise OperationError(None, None, f"wanted an object with the field op, got {describe(value)}")
    op = value.get("op")
    # A list or an object cannot be looked up in a table.
    model = OPERATIONS.get(op) if isinstance(op, str) else None
    if model is None:
        got = describe(op) if "op" in value else "none"
        raise OperationError(None, "op", f"wanted one of {', '.join(OPERATIONS)}; got {got}")
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise _refusal(op, model, value, error) from error


def _refusal(op: Any, model: type[Operation], value: dict[str, Any], error: ValidationError) -> OperationError:
    """Turn the first of pydantic's findings into one line."""
    # A field of several types yields one finding for each; all of them are about the same field.
    field = str(error.errors(include_url=False)[0]["loc"][0])
    wanted = model.model_fields[field].description
    got = describe(value[field]) if field in value else "none"
    return OperationError(op, field, f"wanted {wanted}, got {got}")
