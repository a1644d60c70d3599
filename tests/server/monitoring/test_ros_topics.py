import asyncio
import logging
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import pytest

from harness.clients import ArmClient, values_of
from harness.server import ServerOnBus
from harness.waiting import until
from robot import logs as changed
from robot.faults import REMEDIES, SIMULATED_REMEDIES, Fault, FaultCode, ServoAlert, ServoWarning
from robot.hardware.interface import StatusFlag
from robot.messages import ArmHealth, ArmState, BusCounters, JointHealth, Mode
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.monitoring.ros_topics import (
    GET_LEVELS,
    LOG_DEPTH,
    MAX_REQUESTED,
    MAX_WAITING,
    ROSOUT_TOPIC,
    SET_LEVELS,
    TOPIC,
    Diagnostics,
    Rosout,
    diagnostic_array,
    offer_level_services,
)
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


def statuses(
    state: ArmState = STATE, health: ArmHealth | None = HEALTH, health_age_s: float = 0.5, state_age_s: float = 0.5
) -> list[dict[str, Any]]:
    told: list[dict[str, Any]] = diagnostic_array(state, health, 1e9, "so101", state_age_s, health_age_s)["status"]
    return told


def test_a_sound_arm_is_ok_with_the_figures_of_bus_loop_and_servos() -> None:
    arm, servo = statuses()
    assert (arm["level"], servo["level"]) == (0, 0)
    values = values_of(arm)
    assert values["loop_lateness_ms"] == "p50 0.100, p99 0.200, max 0.300"
    assert (values["bus_sent"], values["bus_timeouts"]) == ("7", "1")
    assert servo["hardware_id"] == "servo 3"
    assert values_of(servo)["temperature_c"] == "31"
    assert values_of(servo)["torque"] == "on"


def test_an_ideal_joint_has_neither_temperature_nor_bus() -> None:
    ideal = replace(SERVO, hardware_id="ideal joint", temperature_c=NAN, voltage_v=NAN, current_a=NAN, load=0.0)
    arm, joint = statuses(health=replace(HEALTH, port="ideal", joints=(ideal,), bus=None))
    assert (arm["level"], joint["level"], joint["hardware_id"]) == (0, 0, "ideal joint")
    assert values_of(joint).keys() == values_of(statuses()[1]).keys() - {"temperature_c", "voltage_v", "current_a"}
    assert values_of(arm)["port"] == "ideal"
    assert not [key for key in values_of(arm) if key.startswith("bus")]


def test_priority_and_memory_of_the_arm_process_are_reported() -> None:
    values = values_of(statuses(health=replace(HEALTH, memory_locked=True))[0])
    assert (values["real_time_priority"], values["memory_locked"]) == ("true", "true")
    assert values_of(statuses()[0])["memory_locked"] == "false"


# Real time factor, rate and age of the report [s]; then the levels of the arm and of the servo, and words of the arm.
SIMULATED = {
    "slow": (0.42, 1.0, 0.5, 1, 0, "the arm holds, at 42% of real time: this machine is busy"),
    "nearly in time": (0.95, 1.0, 0.5, 0, 0, "the arm holds"),
    "slower than its rate": (6.0, 10.0, 2.0, 1, 0, "at 600% of real time, not 1000%: this machine is busy"),
    "nearly at its rate": (9.5, 10.0, 0.5, 0, 0, "the arm holds"),
    "slow, and seldom heard": (0.25, 1.0, 8.0, 1, 0, "at 25% of real time"),
    "heard too seldom": (0.5, 1.0, 8.0, 1, 3, "at 50% of real time"),
}


@pytest.mark.parametrize(("factor", "rate", "age_s", "of_arm", "of_servo", "words"), SIMULATED.values(), ids=SIMULATED)
def test_a_simulated_arm_says_how_its_time_passes_and_reports_as_seldom(
    factor: float, rate: float, age_s: float, of_arm: int, of_servo: int, words: str
) -> None:
    arm, servo = statuses(health=replace(HEALTH, real_time_factor=factor, rate=rate), health_age_s=age_s)
    assert (arm["level"], servo["level"]) == (of_arm, of_servo)
    assert words in arm["message"]
    assert values_of(arm)["real_time_factor"] == f"{factor:.2f}"


STALLED = replace(STATE, mode=Mode.FAULT, fault=Fault(FaultCode.STALLED, "joint elbow_flex is stalled", "elbow_flex"))

# State, health, and the levels and the beginnings of the messages of the arm and of the servo.
LEVELS = {
    "a warning of a servo": (STATE, {"joints": (replace(SERVO, warnings=(WARM,)),)}, 1, 1, "warm: 56 degC"),
    "the joint of a fault": (STALLED, {}, 2, 2, ""),
    "a fault of a slow arm": (STALLED, {"real_time_factor": 0.42}, 2, 2, ""),
}


@pytest.mark.parametrize(("state", "changes", "of_arm", "of_servo", "words"), LEVELS.values(), ids=LEVELS.keys())
def test_one_servo_complains(state: ArmState, changes: dict[str, Any], of_arm: int, of_servo: int, words: str) -> None:
    arm, servo = statuses(state, replace(HEALTH, **changes))
    assert (arm["level"], servo["level"]) == (of_arm, of_servo)
    assert arm["message"].startswith(str(state.fault or ""))
    assert words in servo["message"]


def story(joint: JointHealth = SERVO, state: ArmState = STATE, **fields: Any) -> dict[str, str]:
    told: dict[str, str] = values_of(statuses(state, replace(HEALTH, joints=(joint,), **fields))[1])
    return told


def test_a_joint_tells_its_errors_by_kind_and_what_to_do_about_each() -> None:
    told = story(replace(SERVO, errors={"overload": 2, "servo_rebooted": 1}))
    counted = {key: value for key, value in told.items() if key.startswith("error/")}
    assert counted == {"error/silent_cycles": "2", "error/overload": "2", "error/servo_rebooted": "1"}
    assert told["advice"].count("overload: ") == told["advice"].count("servo_rebooted: ") == 1
    assert REMEDIES[FaultCode.OVERLOAD] in told["advice"]


def test_a_joint_tells_the_registers_of_its_servo_and_what_a_setting_should_be_that_differs() -> None:
    told = story(replace(SERVO, registers={"P_GAIN": 16, "HOMING_OFFSET": -12}, expected={"P_GAIN": 32}))
    registers = {key: value for key, value in told.items() if key.startswith(("register/", "expected/"))}
    assert registers == {"register/P_GAIN": "16", "register/HOMING_OFFSET": "-12", "expected/P_GAIN": "32"}


@pytest.mark.parametrize(
    ("joint", "alert"),
    [
        (replace(SERVO, warnings=(WARM,)), "warm: "),
        (replace(SERVO, status=int(StatusFlag.ENCODER)), "encoder: "),
        (replace(SERVO, silent_cycles=100), "silent_cycles: "),
    ],
)
def test_an_alert_of_the_moment_has_its_advice(joint: JointHealth, alert: str) -> None:
    assert story(joint, bus=BusCounters(sent=1000))["advice"].startswith(alert)


@pytest.mark.parametrize(("lost", "sent"), [(0, 100), (21, 10_000), (19, 100)])
def test_no_and_single_lost_replies_need_no_advice(lost: int, sent: int) -> None:
    assert "advice" not in story(replace(SERVO, silent_cycles=lost), bus=BusCounters(sent=sent))


def test_the_joint_of_a_fault_has_its_remedy_once() -> None:
    fault = Fault(FaultCode.OVERLOAD, "joint elbow_flex is overloaded", "elbow_flex")
    overloaded = replace(SERVO, status=int(StatusFlag.OVERLOAD), errors={"overload": 1})
    told = story(overloaded, replace(STATE, mode=Mode.FAULT, fault=fault))
    assert told["advice"] == str(fault)


def test_a_simulated_servo_has_the_advice_for_simulated_ones() -> None:
    told = story(replace(SERVO, errors={"overload": 1}), port="simulated")
    assert told["advice"].endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])


def test_what_says_nothing_more_is_stale() -> None:
    assert statuses(health=replace(HEALTH, joints=(replace(SERVO, age_s=2.0),)))[1]["level"] == 3
    assert statuses(health_age_s=4.0)[1]["level"] == 3
    assert statuses(replace(STATE, mode=Mode.DISCONNECTED))[1]["level"] == 3
    arm = statuses(state_age_s=4.0)[0]
    assert (arm["level"], arm["message"]) == (3, "the last state of the arm is 4.0 s old")


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 6.3e8, -6.3e8])
def test_an_arm_is_as_old_as_a_clock_says_that_is_never_set(jump_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, now_s = Graph(REGISTRY), 100.0
    diagnostics = Diagnostics(graph, "so101", lambda: None, lambda: now_s)
    heard = listen(graph, TOPIC)
    diagnostics.take_state(STATE)
    diagnostics.take_health(HEALTH)
    monkeypatch.setattr(time, "time", lambda: STATE.stamp_s + jump_s)
    diagnostics.publish(STATE)
    now_s += 4.0
    diagnostics.publish(STATE)
    assert [[each["level"] for each in message["status"]] for message in heard] == [[0, 0], [3, 3]]


def test_before_the_first_report_there_is_the_arm_alone() -> None:
    assert [status["name"] for status in statuses(health=None)] == ["arm"]


async def test_a_silent_servo_shows_within_seconds(client: ArmClient, served: ServerOnBus) -> None:
    served.emulator.command(offline=[3])
    await client.until(
        "/diagnostics",
        lambda arrays: any(
            status["name"] == "arm: elbow_flex" and status["level"] == 2 for status in arrays[-1]["status"]
        ),
    )


pytestmark = pytest.mark.usefixtures("levels_are_put_back")

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
async def heard() -> AsyncIterator[list[Any]]:
    graph = Graph(REGISTRY)
    rosout = Rosout(graph, asyncio.get_running_loop())
    yield listen(graph, ROSOUT_TOPIC)
    rosout.close()


async def test_a_record_is_published_with_level_name_and_place_and_without_a_token(heard: list[Any]) -> None:
    LOG.warning("too %s: %s", "hot", "/?token=s3cret")
    await asyncio.sleep(0)
    assert [(m["level"], m["name"], m["msg"], m["file"]) for m in heard] == [
        (30, "armbridge.test", "too hot: /?token=***", "test_ros_topics.py")
    ]


async def test_a_new_subscriber_gets_the_last_records() -> None:
    graph = Graph(REGISTRY)
    rosout = Rosout(graph, asyncio.get_running_loop())
    for number in range(LOG_DEPTH + 5):
        LOG.warning("line %d", number)
    await asyncio.sleep(0)
    kept = graph.subscribe(Node("late"), ROSOUT_TOPIC, None, Subscriber(lambda _: None))
    rosout.close()
    assert [published.msg["msg"] for published in kept] == [f"line {number}" for number in range(5, LOG_DEPTH + 5)]


async def test_a_record_of_another_thread_is_published(heard: list[Any]) -> None:
    await asyncio.to_thread(LOG.error, "from afar")
    await until(lambda: heard)
    assert [m["msg"] for m in heard] == ["from afar"]


async def test_a_burst_is_bounded(heard: list[Any]) -> None:
    for number in range(MAX_WAITING + 500):
        LOG.warning("%d", number)
    await asyncio.sleep(0)
    assert len(heard) == MAX_WAITING
    LOG.warning("after the burst")
    await asyncio.sleep(0)
    assert heard[-1]["msg"] == "after the burst"


# Levels.


@pytest.fixture
async def graph() -> Graph:
    made = Graph(REGISTRY)
    offer_level_services(made)
    return made


def call(graph: Graph, service: str, **request: Any) -> dict[str, Any]:
    response = answered(graph, service, **request)
    assert response.ok, response.values
    return dict(response.values)


async def test_a_level_is_set_and_told(graph: Graph) -> None:
    done = call(graph, SET_LEVELS, levels=[{"name": "armbridge.gateway", "level": 40}])
    assert done == {"results": [{"successful": True, "reason": ""}]}
    assert logging.getLogger("armbridge.gateway").level == logging.ERROR
    told = call(graph, GET_LEVELS, names=["armbridge.gateway", "armbridge.nothing", "root"])
    assert [level["level"] for level in told["levels"]] == [40, 0, 0]
    # Asking for a level makes no logger.
    assert "armbridge.nothing" not in logging.root.manager.loggerDict


REFUSED = {
    "another's logger": ("asyncio", 10, "name: must be armbridge or a logger below it"),
    "the root": ("", 10, "name: must be"),
    "a name that is none": ("armbridge.Über", 10, "name: must be"),
    "a level between": ("armbridge", 15, "level: must be one of 0, 10, 20, 30, 40, 50, not 15"),
}


@pytest.mark.parametrize(("name", "level", "reason"), REFUSED.values(), ids=REFUSED.keys())
async def test_a_bad_log_level_is_refused_by_field_and_value(graph: Graph, name: str, level: int, reason: str) -> None:
    good = {"name": "armbridge.gateway", "level": 30}
    bad, other = call(graph, SET_LEVELS, levels=[{"name": name, "level": level}, good])["results"]
    assert not bad["successful"]
    assert reason in bad["reason"]
    assert other["successful"]


async def test_loggers_without_end_are_refused(graph: Graph) -> None:
    names = [f"armbridge.many.l{number}" for number in range(changed.MAX_CHANGED_LOGGERS + 1)]
    results = call(graph, SET_LEVELS, levels=[{"name": name, "level": 0} for name in names])["results"]
    assert [each["successful"] for each in results].count(False) == 1
    assert f"{changed.MAX_CHANGED_LOGGERS} loggers" in results[-1]["reason"]


@pytest.mark.parametrize(
    ("service", "field", "entry"), [(GET_LEVELS, "names", "armbridge"), (SET_LEVELS, "levels", {})]
)
async def test_more_than_all_loggers_are_refused_at_once(graph: Graph, service: str, field: str, entry: object) -> None:
    response = answered(graph, service, **{field: [entry] * (MAX_REQUESTED + 1)})
    assert (response.ok, response.values) == (
        False,
        f"Service {service}: field {field}: wanted at most {MAX_REQUESTED} elements in all, got {MAX_REQUESTED + 1}",
    )
