"""Operations: what a client can ask for, one model per op of rosbridge v2.

A row of `OPERATIONS` is all that an op needs to be understood. A field's description says what it takes;
refusals quote it. Fields that are not listed are ignored, as rosbridge ignores them.
"""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from protocol.errors import OperationError, describe


def qualify(name: str) -> str:
    """Return the fully qualified name; rosbridge clients have no namespace, so a relative name lives in the root."""
    return name if name.startswith("/") else f"/{name}"


# Texts that mean false where any value counts.
_SAYS_NO = ("", "false", "0", "no", "null", "none")


def is_true(value: object) -> bool:
    """Return the truth value of any JSON value; of texts, those that say no are false."""
    return value.strip().lower() not in _SAYS_NO if isinstance(value, str) else bool(value)


# ROS 2 middleware takes no longer names of topics and types.
MAX_NAME_CHARACTERS = 255

# Clients use UUIDs or topic names with a prefix; the id of every subscription is kept.
MAX_ID_CHARACTERS = 512

MAX_SECRET_CHARACTERS = 512

Name: TypeAlias = Annotated[
    str,
    Field(min_length=1, max_length=MAX_NAME_CHARACTERS, description=f"text of 1 to {MAX_NAME_CHARACTERS} characters"),
]
OptionalName: TypeAlias = Annotated[
    Annotated[str, Field(min_length=1, max_length=MAX_NAME_CHARACTERS)] | None,
    Field(description=f"text of 1 to {MAX_NAME_CHARACTERS} characters"),
]
# Some clients draw ids with ``Math.random()``.
OperationId: TypeAlias = Annotated[
    Annotated[str, Field(max_length=MAX_ID_CHARACTERS)] | int | Annotated[float, Field(allow_inf_nan=False)] | None,
    Field(description=f"text of up to {MAX_ID_CHARACTERS} characters, a number or null"),
]
# Answers of providers are matched by the id that the providers were given, so an id is mandatory.
GivenId: TypeAlias = Annotated[
    str, Field(max_length=MAX_ID_CHARACTERS, description=f"text of up to {MAX_ID_CHARACTERS} characters")
]
Count: TypeAlias = Annotated[int, Field(ge=0, description="an integer >= 0")]
FragmentId: TypeAlias = Annotated[
    Annotated[str, Field(max_length=MAX_ID_CHARACTERS)] | int | Annotated[float, Field(allow_inf_nan=False)],
    Field(description=f"text of up to {MAX_ID_CHARACTERS} characters or a number"),
]
Total: TypeAlias = Annotated[int, Field(ge=1, description="an integer >= 1")]
Integer: TypeAlias = Annotated[int, Field(description="an integer")]
Text: TypeAlias = Annotated[str, Field(description="text")]
# rosbridge refuses fractions here, and clients that compute the rate then get nothing. Below 0 it throttles nothing.
Milliseconds: TypeAlias = Annotated[float, Field(allow_inf_nan=False, description="a number of milliseconds")]
Seconds: TypeAlias = Annotated[
    Annotated[float, Field(ge=0, allow_inf_nan=False)] | None, Field(description="seconds >= 0, or null")
]
# ros-sharp always sends 2147483647, so there is no upper bound.
FragmentSize: TypeAlias = Annotated[
    Annotated[int, Field(gt=0)] | None, Field(description="a number of characters > 0, or null")
]
Secret: TypeAlias = Annotated[
    str,
    Field(
        max_length=MAX_SECRET_CHARACTERS, repr=False, description=f"text of up to {MAX_SECRET_CHARACTERS} characters"
    ),
]
Flag: TypeAlias = Annotated[bool, Field(description="true or false")]
# rosbridge takes whatever Python counts as true; a text that says no is meant so.
Truth: TypeAlias = Annotated[bool, BeforeValidator(is_true), Field(description="true or false")]
JsonObject: TypeAlias = Annotated[dict[str, Any], Field(description="an object")]
# Providers that fail give a sentence, an object or nothing; whether it fits is for the one who knows the type.
Anything: TypeAlias = Annotated[Any, Field(description="any value")]
# Number of the last stop that a sender knew of; the server checks it, which makes the numbers.
StopNumber: TypeAlias = Anything
Qos: TypeAlias = Annotated[dict[str, Any] | None, Field(description="an object or null")]
Compression: TypeAlias = Literal["none", "png", "cbor", "cbor-raw"]
Level: TypeAlias = Annotated[
    Literal["none", "error", "warning", "info"], Field(description="none, error, warning or info")
]


class Operation(BaseModel):
    """Base of all operations; ``id`` is returned as it came, ``fragment_size`` [characters] holds from now on."""

    # Strict: text is no number and 1 is no truth value, or "false" would latch a topic.
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")

    op: str
    id: OperationId = None
    fragment_size: FragmentSize = None


class Advertise(Operation):
    """Register the client as a publisher of a topic; ``queue_size`` and ``qos`` have no effect."""

    op: Literal["advertise"] = "advertise"
    topic: Name
    type: Name
    latch: Truth = False
    queue_size: Anything = None
    qos: Qos = None


class Unadvertise(Operation):
    """Withdraw one registration of a publisher (by id), or all of this client on the topic (no id)."""

    op: Literal["unadvertise"] = "unadvertise"
    topic: Name


class Publish(Operation):
    """Publish one message, whatever it is: the topic knows its type; ``type`` and ``queue_size`` have no effect."""

    op: Literal["publish"] = "publish"
    topic: Name
    msg: Anything = Field(default_factory=dict)
    type: OptionalName = None
    latch: Truth = False
    queue_size: Anything = None
    after_stop: StopNumber = None


# From rosbridge_library, capabilities/subscribe.py: the first that any id asks for serves them all.
COMPRESSIONS: tuple[Compression, ...] = ("cbor-raw", "cbor", "png", "none")


class Subscribe(Operation):
    """Ask for the messages of a topic; ``throttle_rate`` is in milliseconds, and ``qos`` has no effect."""

    op: Literal["subscribe"] = "subscribe"
    topic: Name
    type: OptionalName = None
    throttle_rate: Milliseconds = 0.0
    queue_length: Count = 0
    compression: Text = "none"
    qos: Qos = None

    @property
    def encoding(self) -> Compression:
        """Applied compression: an unknown one counts as none, as in rosbridge_library."""
        return next((each for each in COMPRESSIONS if each == self.compression), "none")


class Unsubscribe(Operation):
    """Withdraw one subscription (by id), or all of this client on the topic (no id)."""

    op: Literal["unsubscribe"] = "unsubscribe"
    topic: Name


class CallService(Operation):
    """Call a service; behind a ``#`` its name may contain the id.

    ``args`` has the request's fields by name or in order. ``timeout`` [s] 0 is the server's limit, None its default.
    """

    op: Literal["call_service"] = "call_service"
    service: Name
    args: Anything = None
    type: Anything = None
    timeout: Seconds = None
    after_stop: StopNumber = None


class AdvertiseService(Operation):
    """Offer a service, in place of its former provider."""

    op: Literal["advertise_service"] = "advertise_service"
    service: Name
    type: Name


class UnadvertiseService(Operation):
    """Withdraw a service; calls in flight fail."""

    op: Literal["unadvertise_service"] = "unadvertise_service"
    service: Name


class ServiceResponse(Operation):
    """Answer a call by the id that its provider got; ``values`` of a failure are a sentence, an object or nothing."""

    op: Literal["service_response"] = "service_response"
    id: GivenId
    service: Name
    values: Anything = None
    result: Flag


class SendActionGoal(Operation):
    """Send a goal to an action server."""

    op: Literal["send_action_goal"] = "send_action_goal"
    action: Name
    action_type: Name
    args: Anything = None
    feedback: Flag = False
    after_stop: StopNumber = None


class CancelActionGoal(Operation):
    """Ask for the end of a goal that the client has sent under this id."""

    op: Literal["cancel_action_goal"] = "cancel_action_goal"
    action: Name


class AdvertiseAction(Operation):
    """Offer an action, in place of its former provider."""

    op: Literal["advertise_action"] = "advertise_action"
    action: Name
    type: Name


class UnadvertiseAction(Operation):
    """Withdraw an action; goals in flight end."""

    op: Literal["unadvertise_action"] = "unadvertise_action"
    action: Name


class ActionFeedback(Operation):
    """Report the progress of a goal, as its provider; the id is the goal's, as the provider got it."""

    op: Literal["action_feedback"] = "action_feedback"
    id: GivenId
    action: Name
    values: JsonObject = Field(default_factory=dict)


class ActionResult(Operation):
    """End a goal by the id that its provider got, with a status of action_msgs/GoalStatus."""

    op: Literal["action_result"] = "action_result"
    id: GivenId
    action: Name
    values: Anything = None
    status: Integer
    result: Flag


class Fragment(Operation):
    """One piece of a longer frame."""

    op: Literal["fragment"] = "fragment"
    id: FragmentId
    data: Text
    num: Count
    total: Total


class Png(Operation):
    """A frame packed into a picture: its bytes are the pixels."""

    op: Literal["png"] = "png"
    data: Text


class Auth(Operation):
    """Authenticate by a token; rosauth's proofs, as of ROS 1's rosbridge, are not taken."""

    op: Literal["auth"] = "auth"
    token: Secret


class SetLevel(Operation):
    """Choose which status messages the client gets from now on."""

    op: Literal["set_level"] = "set_level"
    level: Level


class Status(Operation):
    """A message for the server's log."""

    op: Literal["status"] = "status"
    level: Level = "info"
    msg: Text


# Operations that may ask for a motion.
Request: TypeAlias = Publish | CallService | SendActionGoal

OPERATIONS: dict[str, type[Operation]] = {
    model.model_fields["op"].default: model for model in Operation.__subclasses__()
}


def parse(value: object) -> Operation:
    """Read one decoded frame as an operation, or raise OperationError."""
    if not isinstance(value, dict):
        raise OperationError(None, None, f"wanted an object with the field op, got {describe(value)}")
    op = value.get("op")
    # A list or an object cannot be looked up in a table.
    model = OPERATIONS.get(op) if isinstance(op, str) else None
    if model is None:
        got = describe(op) if "op" in value else "none"
        raise OperationError(None, "op", f"wanted one of {', '.join(OPERATIONS)}; got {got}")
    try:
        # What `model_validate` calls in the end; on the way there it spends a third of its time.
        operation: Operation = model.__pydantic_validator__.validate_python(value)
    except ValidationError as error:
        raise _refusal(op, model, value, error) from error
    return operation


def _refusal(op: Any, model: type[Operation], value: dict[str, Any], error: ValidationError) -> OperationError:
    """Turn the first of pydantic's findings into one line."""
    # A field of several types yields one finding for each; all of them are about the same field.
    field = str(error.errors(include_url=False)[0]["loc"][0])
    wanted = f"wanted {model.model_fields[field].description}"
    if field not in value:
        return OperationError(op, field, f"{wanted}, got none")
    got = f", got {describe(value[field])}" if model.model_fields[field].repr else "; what came is not shown"
    return OperationError(op, field, wanted + got)
