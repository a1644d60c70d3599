import json
from pathlib import Path

import pytest

from protocol.errors import InterfaceError
from protocol.registry import ArrayBounds, Registry

REFERENCE = Path(__file__).parents[3] / "shared" / "data" / "interfaces_ros2.json"


def field(registry, type_name, field_name):
    return next(field for field in registry.message(type_name).fields if field.name == field_name)


def every_message_name(registry):
    return [name for name, definition in registry._table.items() if definition["kind"] == "msg"]


def test_a_type_is_the_same_in_two_parts_and_in_three(registry):
    assert registry.message("std_msgs/String") is registry.message("std_msgs/msg/String")
    assert registry.canonical("std_msgs/String") == "std_msgs/msg/String"


def test_the_tables_hold_every_interface_of_the_reference():
    if not REFERENCE.exists():
        pytest.skip(f"the reference tables are not at {REFERENCE}")
    assert Registry.load()._table == json.loads(REFERENCE.read_text())


def test_every_message_type_of_the_tables_and_all_that_it_refers_to_can_be_read(registry):
    names = every_message_name(registry)
    assert len(names) == 240
    for name in names:
        for each in registry.message(name).fields:
            assert each.primitive or registry.message(each.base).name == each.base


@pytest.mark.parametrize(
    "name", ["std_msgs/string", "Std_msgs/String", "String", "", "/", "a/b/c/d", "std_msgs/srv/String", "std_msgs/"]
)
def test_a_name_that_does_not_match_to_the_letter_is_refused(registry, name):
    with pytest.raises(InterfaceError, match="unknown") as refusal:
        registry.message(name)
    assert refusal.value.type_name == name


@pytest.mark.parametrize("name", ["std_srvs/srv/Trigger", "control_msgs/action/PointHead"])
def test_services_and_actions_are_no_message_types(registry, name):
    with pytest.raises(InterfaceError, match="wanted a message type"):
        registry.message(name)


def test_a_name_shared_by_message_and_action_is_the_message_in_two_parts(registry):
    assert registry.canonical("control_msgs/GripperCommand") == "control_msgs/msg/GripperCommand"


def test_fields_keep_the_order_of_their_declaration(registry):
    names = [field.name for field in registry.message("sensor_msgs/JointState").fields]
    assert names == ["header", "name", "position", "velocity", "effort"]


def test_references_are_resolved_to_canonical_names(registry):
    header = field(registry, "sensor_msgs/JointState", "header")
    assert (header.base, header.array, header.primitive) == ("std_msgs/msg/Header", None, False)


def test_arrays_are_free_fixed_or_bounded(registry):
    free = field(registry, "sensor_msgs/JointState", "position").array
    fixed = field(registry, "unique_identifier_msgs/UUID", "uuid").array
    bounded = field(registry, "shape_msgs/SolidPrimitive", "dimensions").array
    assert (free, free.fixed) == (ArrayBounds(0, None), False)
    assert (fixed, fixed.fixed) == (ArrayBounds(16, 16), True)
    assert (bounded, bounded.fixed) == (ArrayBounds(0, 3), False)


def test_defaults_come_in_the_type_of_their_field(registry):
    assert field(registry, "geometry_msgs/Quaternion", "w").default == 1.0
    assert field(registry, "rcl_interfaces/ParameterDescriptor", "read_only").default is False
    assert field(registry, "sensor_msgs/NavSatStatus", "status").default == -2
    assert field(registry, "std_msgs/String", "data").default is None


def test_a_field_type_that_cannot_be_read_is_refused_by_name():
    table = {"a/msg/B": {"kind": "msg", "fields": [["data", "float64[x]"]]}}
    with pytest.raises(InterfaceError, match="field data"):
        Registry(table).message("a/B")


def test_a_text_default_stays_text():
    table = {"a/msg/B": {"kind": "msg", "fields": [["data", "string", "7"]]}}
    assert Registry(table).message("a/B").fields[0].default == "7"
