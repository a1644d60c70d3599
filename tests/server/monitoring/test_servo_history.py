from dataclasses import replace
from typing import Any

import pytest

from robot.faults import Fault, FaultCode, ServoAlert, ServoWarning
from robot.messages import ArmState, Mode
from server.graph.topics import Graph
from server.monitoring.servo_history import MAX_EVENTS, MAX_SAMPLES, SERVICE, ServoHistory
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY
from tests.server.monitoring.watched_parts import JOINTS, arm_health

NAN = float("nan")
STATE = ArmState(100.0, Mode.HOLDING, JOINTS)
STALLED = Fault(FaultCode.STALLED, "joint gripper is stalled", "gripper")


class World:
    """A history whose clock stands until a test moves it."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.graph = Graph(REGISTRY, lambda: self.now_s)
        self.history = ServoHistory(self.graph)

    def report(self, joint: str = "gripper", after_s: float = 1.0, **fields: Any) -> None:
        self.now_s += after_s
        health = arm_health()
        joints = tuple(replace(each, **fields) if each.joint == joint else each for each in health.joints)
        self.history.take_health(replace(health, joints=joints))

    def asked(self, joint: str = "gripper") -> dict[str, Any]:
        response = answered(self.graph, SERVICE, joint=joint)
        assert response.ok, response.values
        return dict(response.values)


@pytest.fixture
async def world() -> World:
    return World()


async def test_the_history_of_a_servo_has_its_samples_oldest_first_with_their_age(world: World) -> None:
    world.report(temperature_c=40.0, load=0.1, voltage_v=5.1, current_a=0.2)
    world.report(temperature_c=41.0, load=0.2, voltage_v=5.0, current_a=0.3)
    world.now_s += 0.5
    samples = {"time_s": [-1.5, -0.5], "temperature_c": [40.0, 41.0], "load": [0.1, 0.2]}
    samples |= {"voltage_v": [5.1, 5.0], "current_a": [0.2, 0.3]}
    assert world.asked() == world.asked() | {"success": True, **samples}
    assert world.asked("shoulder_pan")["temperature_c"] == [31.0, 31.0]


async def test_samples_that_are_old_too_many_or_not_measured_are_left_out(world: World) -> None:
    world.report(temperature_c=NAN, current_a=NAN)
    told = world.asked()
    assert (told["temperature_c"], told["current_a"], len(told["load"])) == ([], [], 1)
    world.report(temperature_c=40.0)
    world.report(after_s=601.0, temperature_c=41.0)
    assert world.asked()["temperature_c"] == [41.0]
    for number in range(MAX_SAMPLES + 50):
        world.report(after_s=0.5, temperature_c=float(number))
    told = world.asked()["temperature_c"]
    assert (len(told), told[0], told[-1]) == (MAX_SAMPLES, 50.0, MAX_SAMPLES + 49.0)


async def test_an_unknown_joint_is_refused_with_those_that_have_reported(world: World) -> None:
    refusals = [[world.asked(joint) for joint in ("", "elbow")]]
    world.report()
    refusals.append([world.asked(joint) for joint in ("", "elbow")])
    assert not any(told["success"] for both in refusals for told in both)
    assert [told["message"] for told in refusals[0]] == ["the arm has not reported on its servos yet"] * 2
    known = "joint: must be one of shoulder_pan, gripper, not"
    assert [told["message"] for told in refusals[1]] == [f"{known} ''", f"{known} 'elbow'"]


async def test_a_warning_is_an_event_when_it_comes_and_goes_and_events_do_not_fill_the_memory(world: World) -> None:
    for degrees in (55, 56, 57):
        world.report(warnings=(ServoWarning(ServoAlert.WARM, f"warm: {degrees} degC"),))
    world.report()
    world.now_s += 10.0
    assert world.asked()["events"] == ["13 s ago: warning: warm: 55 degC", "10 s ago: no longer: warm: 57 degC"]
    assert world.asked("shoulder_pan")["events"] == []
    for number in range(MAX_EVENTS):
        world.report(after_s=0.1, warnings=(ServoWarning(ServoAlert.WARM, f"warm: {number} degC"),))
        world.report(after_s=0.1)
    assert len(world.asked()["events"]) == MAX_EVENTS


async def test_a_fault_of_a_joint_and_its_reset_are_events_of_that_joint(world: World) -> None:
    world.report()
    for state in (STATE, replace(STATE, mode=Mode.FAULT, fault=STALLED), STATE):
        world.history.take_state(state)
    assert world.asked()["events"] == [
        "0 s ago: fault stalled: joint gripper is stalled",
        "0 s ago: fault stalled was reset",
    ]
    assert world.asked("shoulder_pan")["events"] == []


async def test_an_error_that_was_counted_between_two_reports_is_an_event(world: World) -> None:
    world.report()
    world.report(errors={"overload": 1})
    world.report(errors={"overload": 1})
    world.report(errors={"overload": 3})
    assert world.asked()["events"] == [
        "2 s ago: error overload, 1 since the servo was connected",
        "0 s ago: error overload, 3 since the servo was connected",
    ]


async def test_a_lost_arm_is_an_event_of_every_joint(world: World) -> None:
    world.report()
    for state in (STATE, replace(STATE, mode=Mode.DISCONNECTED, reason="the port is gone"), STATE):
        world.history.take_state(state)
    expected = ["0 s ago: disconnected: the port is gone", "0 s ago: connected"]
    assert [world.asked(joint)["events"] for joint in JOINTS] == [expected, expected]
