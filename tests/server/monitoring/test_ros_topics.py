import asyncio
import logging
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import pytest

from harness.clients import values_of
from harness.waiting import until
from robot import logs as changed
from robot.faults import REMEDIES, SIMULATED_REMEDIES, Fault, FaultCode, ServoAlert, ServoWarning
from robot.hardware.interface import StatusFlag
from robot.messages import ArmHealth, ArmState, BusCounters, JointHealth, Mode
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from server.monitoring import ros_topics
from server.monitoring.ros_topics import MAX_REQUESTED, MAX_WAITING, SET_LEVELS, Rosout
from tests.helpers.clock import FakeClock
from tests.helpers.graph import answered, listen
from tests.helpers.messages import REGISTRY

WARM = ServoWarning(ServoAlert.WARM, "warm: 56 degC")
SERVO = JointHealth("elbow_flex", "servo 3", 0.5, 31, 5.0, 0.1, -0.2, True, 0, 0.01, 2)
HEALTH = ArmHealth(
    100.0,
    Mode.HOLDING,
    "/dev/arm",
    (SERVO,),
    BusCounters(sent=7, timeouts=1),
    (0.0001, 0.0002, 0.0003),
    (0.002, 0.003, 0.004),
    True,
)
STATE = ArmState(100.0, Mode.HOLDING, ("elbow_flex",))
NAN = float("nan")


def timed(factor: float, rate: float = 1.0) -> dict[str, Any]:
    """Changes of a report: the passing of a simulated arm's time."""
    return {"real_time_factor": factor, "rate": rate}


def statuses(
    state: ArmState = STATE, health: ArmHealth | None = HEALTH, health_age_s: float = 0.5, state_age_s: float = 0.5
) -> list[dict[str, Any]]:
    clock = FakeClock()
    graph = Graph(REGISTRY, clock)
    diagnostics = ros_topics.Diagnostics(graph, "so101", lambda: None)
    heard = listen(graph, ros_topics.TOPIC)
    diagnostics.take_state(state)
    clock.advance(state_age_s)
    if health is not None:
        diagnostics.take_health(replace(health, monotonic_s=clock() - health_age_s))
    diagnostics.publish()
    told: list[dict[str, Any]] = heard[0]["status"]
    return told


def test_a_sound_arm_is_ok_with_the_figures_of_bus_loop_and_servos_and_an_ideal_one_with_fewer() -> None:
    arm, servo = statuses(health=replace(HEALTH, memory_locked=True))
    assert (arm["level"], servo["level"], servo["hardware_id"]) == (0, 0, "servo 3")
    told = {"loop_lateness_ms": "p50 0.100, p99 0.200, max 0.300", "bus_sent": "7", "bus_timeouts": "1"}
    told |= {"real_time_priority": "true", "memory_locked": "true"}
    assert values_of(arm) | told == values_of(arm)
    assert values_of(statuses()[0])["memory_locked"] == "false"
    assert (values_of(servo)["temperature_c"], values_of(servo)["torque"]) == ("31", "on")
    ideal = replace(SERVO, hardware_id="ideal joint", temperature_c=NAN, voltage_v=NAN, current_a=NAN, load=0.0)
    arm, joint = statuses(health=replace(HEALTH, port="ideal", joints=(ideal,), bus=None))
    assert (arm["level"], joint["level"], joint["hardware_id"]) == (0, 0, "ideal joint")
    assert values_of(joint).keys() == values_of(statuses()[1]).keys() - {"temperature_c", "voltage_v", "current_a"}
    assert values_of(arm)["port"] == "ideal"
    assert not [key for key in values_of(arm) if key.startswith("bus")]


STALLED = replace(STATE, mode=Mode.FAULT, fault=Fault(FaultCode.STALLED, "joint elbow_flex is stalled", "elbow_flex"))

# State, changes of the report, its age [s]; then the levels of the arm and of the servo, and words of their messages.
LEVELS: dict[str, tuple[ArmState, dict[str, Any], float, tuple[int, int], str, str]] = {
    "slow": (STATE, timed(0.42), 0.5, (1, 0), "the arm holds, at 42% of real time: this machine is busy", ""),
    "nearly in time": (STATE, timed(0.95), 0.5, (0, 0), "the arm holds", ""),
    "slower than its rate": (STATE, timed(6.0, 10.0), 2.0, (1, 0), "at 600% of real time, not 1000%: this machine", ""),
    "nearly at its rate": (STATE, timed(9.5, 10.0), 0.5, (0, 0), "the arm holds", ""),
    "slow, and seldom heard": (STATE, timed(0.25), 8.0, (1, 0), "at 25% of real time", ""),
    "heard too seldom": (STATE, timed(0.5), 8.0, (1, 3), "at 50% of real time", ""),
    "a warning of a servo": (STATE, {"joints": (replace(SERVO, warnings=(WARM,)),)}, 0.5, (1, 1), "", "warm: 56 degC"),
    "the joint of a fault": (STALLED, {}, 0.5, (2, 2), str(STALLED.fault), ""),
    "a fault of a slow arm": (STALLED, timed(0.42), 0.5, (2, 2), str(STALLED.fault), ""),
    "a silent servo": (STATE, {"joints": (replace(SERVO, age_s=2.0),)}, 0.5, (1, 3), "", ""),
    "no report": (STATE, {}, 4.0, (1, 3), "", ""),
}


@pytest.mark.parametrize("case", LEVELS)
def test_arm_and_servo_tell_how_they_are_and_how_simulated_time_passes(case: str) -> None:
    state, changes, age_s, levels, of_arm, of_servo = LEVELS[case]
    arm, servo = statuses(state, replace(HEALTH, **changes), health_age_s=age_s)
    assert (arm["level"], servo["level"]) == levels
    assert arm["message"].startswith(str(state.fault or ""))
    assert of_arm in arm["message"]
    assert of_servo in servo["message"]
    assert values_of(arm)["real_time_factor"] == f"{changes.get('real_time_factor', HEALTH.real_time_factor):.2f}"


def story(joint: JointHealth = SERVO, state: ArmState = STATE, **fields: Any) -> dict[str, str]:
    told: dict[str, str] = values_of(statuses(state, replace(HEALTH, joints=(joint,), **fields))[1])
    return told


def test_a_joint_tells_its_errors_by_kind_with_advice_and_its_registers_with_what_should_be_else() -> None:
    told = story(replace(SERVO, errors={"overload": 2, "servo_rebooted": 1}))
    counted = {key: value for key, value in told.items() if key.startswith("error/")}
    assert counted == {"error/silent_cycles": "2", "error/overload": "2", "error/servo_rebooted": "1"}
    assert told["advice"].count("overload: ") == told["advice"].count("servo_rebooted: ") == 1
    assert REMEDIES[FaultCode.OVERLOAD] in told["advice"]
    told = story(replace(SERVO, registers={"P_GAIN": 16, "HOMING_OFFSET": -12}, expected={"P_GAIN": 32}))
    registers = {key: value for key, value in told.items() if key.startswith(("register/", "expected/"))}
    assert registers == {"register/P_GAIN": "16", "register/HOMING_OFFSET": "-12", "expected/P_GAIN": "32"}


def test_an_alert_of_the_moment_has_its_advice() -> None:
    for joint, alert in (
        (replace(SERVO, warnings=(WARM,)), "warm: "),
        (replace(SERVO, status=int(StatusFlag.ENCODER)), "encoder: "),
        (replace(SERVO, silent_cycles=100), "silent_cycles: "),
    ):
        assert story(joint, bus=BusCounters(sent=1000))["advice"].startswith(alert)
    # No and single lost replies need none.
    for lost, sent in ((0, 100), (21, 10_000), (19, 100)):
        assert "advice" not in story(replace(SERVO, silent_cycles=lost), bus=BusCounters(sent=sent)), lost


def test_the_joint_of_a_fault_has_its_remedy_once_and_a_simulated_servo_the_advice_for_simulated_ones() -> None:
    fault = Fault(FaultCode.OVERLOAD, "joint elbow_flex is overloaded", "elbow_flex")
    overloaded = replace(SERVO, status=int(StatusFlag.OVERLOAD), errors={"overload": 1})
    assert story(overloaded, replace(STATE, mode=Mode.FAULT, fault=fault))["advice"] == str(fault)
    told = story(replace(SERVO, errors={"overload": 1}), port="simulated")
    assert told["advice"].endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])


def test_what_says_nothing_more_is_stale_and_before_the_first_report_there_is_the_arm_alone() -> None:
    assert statuses(replace(STATE, mode=Mode.DISCONNECTED))[1]["level"] == 3
    arm = statuses(state_age_s=4.0)[0]
    assert (arm["level"], arm["message"]) == (3, "the last state of the arm is 4.0 s old")
    assert [status["name"] for status in statuses(health=None)] == ["arm"]


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 6.3e8, -6.3e8])
def test_an_arm_is_as_old_as_a_clock_says_that_is_never_set(jump_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    graph = Graph(REGISTRY, lambda: now_s)
    diagnostics = ros_topics.Diagnostics(graph, "so101", lambda: None)
    heard = listen(graph, ros_topics.TOPIC)
    diagnostics.take_state(STATE)
    diagnostics.take_health(HEALTH)
    monkeypatch.setattr(time, "time", lambda: STATE.stamp_s + jump_s)
    diagnostics.publish()
    now_s += 4.0
    diagnostics.publish()
    assert [[each["level"] for each in message["status"]] for message in heard] == [[0, 0], [3, 3]]


pytestmark = pytest.mark.usefixtures("levels_are_put_back")

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
async def heard() -> AsyncIterator[list[Any]]:
    graph = Graph(REGISTRY)
    rosout = Rosout(graph, asyncio.get_running_loop())
    yield listen(graph, ros_topics.ROSOUT_TOPIC)
    rosout.close()


async def test_a_record_is_published_with_level_name_and_place_and_without_a_token(heard: list[Any]) -> None:
    LOG.warning("too %s: %s", "hot", "/?token=s3cret")
    await asyncio.sleep(0)
    assert [(m["level"], m["name"], m["msg"], m["file"]) for m in heard] == [
        (30, "armbridge.test", "too hot: /?token=***", "test_ros_topics.py")
    ]
    # Also one of another thread.
    await asyncio.to_thread(LOG.error, "from afar")
    await until(lambda: [m["msg"] for m in heard[1:]] == ["from afar"])


async def test_a_new_subscriber_gets_the_last_records() -> None:
    graph = Graph(REGISTRY)
    rosout = Rosout(graph, asyncio.get_running_loop())
    for number in range(ros_topics.LOG_DEPTH + 5):
        LOG.warning("line %d", number)
    await asyncio.sleep(0)
    kept = graph.subscribe(Node("late"), ros_topics.ROSOUT_TOPIC, None, Subscriber(lambda _: None))
    rosout.close()
    assert [published.msg["msg"] for published in kept] == [
        f"line {number}" for number in range(5, ros_topics.LOG_DEPTH + 5)
    ]


async def test_a_burst_is_bounded(heard: list[Any]) -> None:
    for number in range(MAX_WAITING + 500):
        LOG.warning("%d", number)
    await asyncio.sleep(0)
    assert len(heard) == MAX_WAITING
    LOG.warning("after the burst")
    await asyncio.sleep(0)
    assert heard[-1]["msg"] == "after the burst"


@pytest.fixture
async def graph() -> Graph:
    made = Graph(REGISTRY)
    ros_topics.offer_level_service(made)
    return made


def call(graph: Graph, service: str, **request: Any) -> dict[str, Any]:
    response = answered(graph, service, **request)
    assert response.ok, response.values
    return dict(response.values)


REFUSED = {
    "another's logger": ("asyncio", 10, "name: must be armbridge or a logger below it"),
    "the root": ("", 10, "name: must be"),
    "a name that is none": ("armbridge.Über", 10, "name: must be"),
    "a level between": ("armbridge", 15, "level: must be one of 0, 10, 20, 30, 40, 50, not 15"),
}


@pytest.mark.parametrize(("name", "level", "reason"), REFUSED.values(), ids=REFUSED.keys())
async def test_a_bad_log_level_is_refused_by_field_and_value_and_a_good_one_is_set(
    graph: Graph, name: str, level: int, reason: str
) -> None:
    good = {"name": "armbridge.gateway", "level": 40}
    bad, other = call(graph, SET_LEVELS, levels=[{"name": name, "level": level}, good])["results"]
    assert not bad["successful"]
    assert reason in bad["reason"]
    assert other == {"successful": True, "reason": ""}
    assert logging.getLogger("armbridge.gateway").level == logging.ERROR


async def test_loggers_without_end_and_more_than_all_are_refused(graph: Graph) -> None:
    names = [f"armbridge.many.l{number}" for number in range(changed.MAX_CHANGED_LOGGERS + 1)]
    results = call(graph, SET_LEVELS, levels=[{"name": name, "level": 0} for name in names])["results"]
    assert [each["successful"] for each in results].count(False) == 1
    assert f"{changed.MAX_CHANGED_LOGGERS} loggers" in results[-1]["reason"]
    response = answered(graph, SET_LEVELS, levels=[{}] * (MAX_REQUESTED + 1))
    wanted = f"wanted at most {MAX_REQUESTED} elements in all, got {MAX_REQUESTED + 1}"
    assert (response.ok, response.values) == (False, f"Service {SET_LEVELS}: field levels: {wanted}")
