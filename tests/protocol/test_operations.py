import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import OperationError
from protocol.operations import MAX_ID_CHARACTERS, MAX_NAME_CHARACTERS, OPERATIONS, parse, qualify


@given(st.text(min_size=1))
def test_a_qualified_name_stays_as_it_is(name):
    assert qualify(qualify(name)) == qualify(name)


MINIMAL = {
    "advertise": {"topic": "/a", "type": "std_msgs/String"},
    "unadvertise": {"topic": "/a"},
    "publish": {"topic": "/a"},
    "subscribe": {"topic": "/a"},
    "unsubscribe": {"topic": "/a"},
    "call_service": {"service": "/s"},
    "advertise_service": {"service": "/s", "type": "std_srvs/SetBool"},
    "unadvertise_service": {"service": "/s"},
    "service_response": {"service": "/s", "id": "service_request:/s:1", "result": True},
    "send_action_goal": {"action": "/a", "action_type": "control_msgs/PointHead"},
    "cancel_action_goal": {"action": "/a"},
    "advertise_action": {"action": "/a", "type": "control_msgs/PointHead"},
    "unadvertise_action": {"action": "/a"},
    "action_feedback": {"action": "/a", "id": "action_goal:/a:1"},
    "action_result": {"action": "/a", "id": "action_goal:/a:1", "status": 4, "result": True},
    "fragment": {"id": "f", "data": "{}", "num": 0, "total": 1},
    "png": {"data": "iVBO"},
    "auth": {"token": "my-secret"},
    "set_level": {"level": "error"},
    "status": {"msg": "hello"},
}

# Answers of providers and fragments must say which call, goal or message they belong to.
WITH_ID = [op for op, fields in MINIMAL.items() if "id" in fields]


def refused(value):
    with pytest.raises(OperationError) as refusal:
        parse(value)
    return refusal.value


def test_every_row_of_the_table_is_keyed_by_the_op_of_its_model():
    assert set(OPERATIONS) == set(MINIMAL)
    for op, fields in MINIMAL.items():
        assert parse({"op": op, **fields}).op == op


def test_an_id_is_text_integer_or_null_and_stays_what_it_is():
    for mark, op in itertools.product(["a", "", 7, -1, None], MINIMAL.keys() - WITH_ID):
        operation = parse({"op": op, **MINIMAL[op], "id": mark})
        assert (operation.id, type(operation.id)) == (mark, type(mark)), op


def test_a_mandatory_field_that_is_missing_is_named():
    for op, field in ((op, field) for op, fields in MINIMAL.items() for field in fields):
        error = refused({"op": op} | {name: value for name, value in MINIMAL[op].items() if name != field})
        assert (error.op, error.field) == (op, field)
        assert str(error).startswith(f"{op}: field {field}: wanted ")
        assert str(error).endswith(", got none")


SENSELESS = {
    ("publish", "topic"): (42, "", "a" * (MAX_NAME_CHARACTERS + 1)),
    ("publish", "id"): (True, float("nan"), {}, "a" * (MAX_ID_CHARACTERS + 1)),
    ("advertise", "type"): (None,),
    ("advertise", "qos"): ("reliable",),
    ("subscribe", "type"): (3,),
    ("subscribe", "throttle_rate"): ("100", True, float("nan"), float("inf")),
    ("subscribe", "queue_length"): (-1, 1.5),
    ("subscribe", "fragment_size"): (0, -5, "many"),
    ("subscribe", "compression"): (7, None),
    ("call_service", "service"): (1,),
    ("call_service", "timeout"): (-1, "long"),
    ("call_service", "fragment_size"): (0,),
    ("service_response", "id"): (7,),
    ("service_response", "result"): ("true",),
    ("action_result", "status"): ("done",),
    ("action_feedback", "values"): ("text",),
    ("send_action_goal", "feedback"): (1,),
    ("fragment", "num"): (-1,),
    ("fragment", "total"): (0,),
    ("fragment", "data"): ({},),
    ("set_level", "level"): ("loud",),
    ("status", "msg"): (None,),
}


def test_latch_is_what_clients_mean_by_any_value() -> None:
    advertise = {"op": "advertise", "topic": "/a", "type": "std_msgs/String"}
    sent = (None, 1, 0, "true", "False", "")
    latched = [parse({**advertise, "latch": value}).latch for value in sent]
    assert latched == [False, True, False, True, False, False]


def test_a_known_field_of_senseless_value_is_named():
    for (op, field), senseless in SENSELESS.items():
        for value in senseless:
            error = refused({"op": op, **MINIMAL[op], field: value})
            assert (error.op, error.field) == (op, field), value
            assert str(error).startswith(f"{op}: field {field}: wanted ")
            assert "\n" not in str(error)


TAKEN = {
    ("publish", "queue_size"): (None, 1.5, -1, "many"),
    ("subscribe", "throttle_rate"): (0, 100, 33.4),
    # ros-sharp always sends this one.
    ("subscribe", "fragment_size"): (2147483647, None),
    ("subscribe", "type"): (None,),
    ("subscribe", "qos"): ({"depth": 1}, None),
    ("call_service", "args"): ({"data": True}, [True], [], {}, None, 5, "text"),
    ("service_response", "values"): (None, "text", {"a": 1}),
}


def test_what_clients_send_is_taken_as_it_is() -> None:
    for (op, field), values in TAKEN.items():
        for value in values:
            assert getattr(parse({"op": op, **MINIMAL[op], field: value}), field) == value, (op, field)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
field_names = sorted({name for model in OPERATIONS.values() for name in model.model_fields} - {"op"})


@given(st.sampled_from(sorted(OPERATIONS)), st.dictionaries(st.sampled_from(field_names), json_values))
def test_any_fields_are_read_or_refused_in_one_line(op, fields):
    try:
        outcome = parse({**fields, "op": op})
    except OperationError as error:
        outcome = error
    assert outcome.op == op
    assert isinstance(outcome, OPERATIONS[op]) or "\n" not in str(outcome)


def test_a_secret_that_is_refused_is_not_shown():
    for token in ("my-secret" * 100, ["my-secret"]):
        refusal = str(refused({"op": "auth", "token": token}))
        assert "field token: wanted text of up to 512 characters" in refusal
        assert "my-secret" not in refusal
