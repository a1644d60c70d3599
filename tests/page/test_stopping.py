"""A stop ends what is driven by hand, whatever is held and whoever stops; the server's record is the judge."""

import functools
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import psutil
import pytest
from playwright.sync_api import Browser
from websockets.exceptions import ConnectionClosed
from websockets.sync import client as blocking

from harness.clients import SPEED_FACTOR, call, publish, values_of
from harness.page import PHONE, SHARED, Fingers, OpenPage, at_ready, opened
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S, join, wait_until
from tests.helpers.arm_record import ArmRecord
from tests.page.test_drive import GAMEPAD, drive

SETTINGS = SHARED

COMMANDED = "/arm_controller/controller_state"
STILL_MESSAGES = 10

# Without setpoints the arm has come to rest by itself after 0.2 s.
TICKS_TO_REST = 100


@pytest.fixture(scope="module")
def phone(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, PHONE, own=True, has_touch=True, is_mobile=True) as open_page:
        open_page.page.add_init_script(GAMEPAD)
        open_page.open(server.port)
        yield open_page
        assert open_page.errors == []


@pytest.fixture
def page(phone: OpenPage, server: RunningServer) -> OpenPage:
    """A phone that shows Drive, with the arm in a pose from which it can be driven everywhere."""
    phone.open_panel("drive")
    phone.until("document.querySelectorAll('.jog-row').length > 5")
    at_ready(phone, server.url)
    phone.part("jog-wrist_flex-plus").scroll_into_view_if_needed()
    return phone


@pytest.fixture
def fingers(page: OpenPage) -> Iterator[Fingers]:
    touching = Fingers(page)
    yield touching
    touching.lift_all()


def test_stop_works_while_another_finger_holds_a_button(page: OpenPage, fingers: Fingers, record: ArmRecord) -> None:
    drive(record, lambda: fingers.press(1, "jog-wrist_flex-minus"), lambda: fingers.lift(1))
    fingers.press(2, "stop")
    record.until_rest()
    page.until_state("s.stop.phase !== 'asked'")
    fingers.lift(2)
    # No other button moves the arm before the first is let go.
    fingers.press(2, "jog-wrist_roll-plus")
    record.until_rest()
    fingers.lift_all()
    drive(record, lambda: fingers.press(1, "jog-wrist_flex-plus"), lambda: fingers.lift(1))
    fingers.lift(1)


@pytest.mark.parametrize("stop", ["service", "topic"])
def test_a_page_that_stood_still_moves_nothing_after_the_stop_of_another(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer, stop: str
) -> None:
    drive(record, lambda: fingers.press(1, "jog-wrist_flex-minus"), lambda: fingers.lift(1))
    last_stop = page.state("arm.last_stop")
    stopping = threading.Timer(0.5, stop_from_elsewhere, (server.url, stop))
    stopping.start()
    page.page.evaluate("(() => { const end = performance.now() + 1500; while (performance.now() < end); })()")
    join(stopping)
    record.until_rest()
    page.until_state(f"s.arm.last_stop !== '{last_stop}'")


@pytest.mark.parametrize("stop", ["page", "service", "topic"])
def test_a_held_stick_moves_nothing_after_a_stop_until_its_button_was_let_go(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer, stop: str
) -> None:
    page.open_panel("drive", "drive-gamepad")
    page.part("gamepad").check()
    page.page.bring_to_front()
    hold, let_go = (functools.partial(page.page.evaluate, f"holdPad([1, 0, 0, 0], {held})") for held in ("[4]", "[]"))
    let_go()
    page.until_text("gamepad-state", "hold a shoulder")
    drive(record, hold, let_go)
    last_stop = page.state("arm.last_stop")
    if stop == "page":
        fingers.press(1, "stop")
    else:
        stop_from_elsewhere(server.url, stop)
    page.until_state(f"s.arm.last_stop !== '{last_stop}'")
    record.until_rest()
    let_go()
    page.until_text("gamepad-state", "hold a shoulder")
    record.until_rest()
    drive(record, hold, let_go)
    let_go()


def test_letting_go_of_a_button_of_the_tip_is_no_slower_than_a_stop(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer
) -> None:
    page.part("jog-z-minus").scroll_into_view_if_needed()
    let_go = functools.partial(fingers.lift, 1)
    stop = functools.partial(stop_from_elsewhere, server.url, "topic")
    ways_rad: dict[Callable[[], None], list[float]] = {let_go: [], stop: []}
    for end, heard_on in ((let_go, "/servo_node/delta_twist_cmds"), (stop, "/stop")) * 3:
        at_ready(page, server.url)
        with heard(server.url, COMMANDED, heard_on) as messages:
            drive(record, lambda: fingers.press(1, "jog-z-minus"), let_go)
            end()
            page.wait(functools.partial(rests, messages))
        ways_rad[end].append(way_after_end_rad(messages))
        let_go()
    assert min(ways_rad[let_go]) < 1.5 * max(ways_rad[stop]), ways_rad


def test_a_button_that_is_let_go_while_the_server_stands_moves_nothing_when_it_goes_on(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer
) -> None:
    page.part("jog-z-minus").scroll_into_view_if_needed()
    with heard(server.url, COMMANDED, "/servo_node/delta_twist_cmds") as messages:
        drive(record, lambda: fingers.press(1, "jog-z-minus"), lambda: fingers.lift(1))
        server.process.send_signal(signal.SIGSTOP)
        until_ticked(server, TICKS_TO_REST)
        fingers.lift(1)
        let_go_s = time.time()
        server.process.send_signal(signal.SIGCONT)
        page.wait(functools.partial(rests, messages))
    after_rad = commanded_rad(messages, since_s=let_go_s)
    assert after_rad == [pytest.approx(after_rad[0], abs=1e-3)] * len(after_rad)


def until_ticked(server: RunningServer, ticks: int) -> None:
    """Wait until the arm's process, which sleeps after each tick, has had time for some."""
    (arm,) = (each for each in psutil.Process(server.process.pid).children() if "robot.control.loop" in each.cmdline())
    first = arm.num_ctx_switches().voluntary
    wait_until(lambda: arm.num_ctx_switches().voluntary > first + ticks)


Heard = list[tuple[str, dict[str, Any]]]


@contextmanager
def heard(url: str, *topics: str) -> Iterator[Heard]:
    """Keep the messages of topics in the order in which the server has had them, while the block lasts."""
    messages: Heard = []
    with blocking.connect(url) as websocket:
        for topic in topics:
            websocket.send(json.dumps({"op": "subscribe", "topic": topic}))

        def keep() -> None:
            with suppress(ConnectionClosed):
                for frame in websocket:
                    operation = json.loads(frame)
                    messages.append((operation["topic"], operation["msg"]))

        reader = threading.Thread(target=keep, daemon=True)
        reader.start()
        yield messages
    reader.join(5.0)


def commanded_rad(messages: Heard, since_s: float = 0.0) -> list[list[float]]:
    states = [msg for topic, msg in messages if topic == COMMANDED and stamp_s(msg) >= since_s]
    return [state["reference"]["positions"] for state in states]


def stamp_s(msg: dict[str, Any]) -> float:
    stamp = msg["header"]["stamp"]
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


def end_at(messages: Heard) -> int:
    """Return the index of the last stop, or command to stand still; -1 for none."""
    return max((i for i, (topic, msg) in enumerate(messages) if topic != COMMANDED and not is_moving(msg)), default=-1)


def is_moving(msg: dict[str, Any]) -> bool:
    return any(value for part in msg.get("twist", {}).values() for value in part.values())


def rests(messages: Heard) -> bool:
    """Return true once the arm is commanded to one place for a while after the end."""
    at = end_at(messages)
    latest = commanded_rad(messages[at:])[-STILL_MESSAGES:]
    return at >= 0 and len(latest) == STILL_MESSAGES and latest[0] == latest[-1]


def way_after_end_rad(messages: Heard) -> float:
    """Return the farthest way of a joint from where the arm was commanded when the server heard the end [rad]."""
    before = commanded_rad(messages[: end_at(messages)])[-1]
    return max(abs(one - other) for one, other in zip(commanded_rad(messages)[-1], before, strict=True))


def stop_from_elsewhere(url: str, way: str) -> None:
    if way == "service":
        assert call(url, "/arm/stop")["success"]
        return
    publish(url, "/stop", "std_msgs/Empty", {})


def test_the_gripper_stays_where_another_has_stopped_it(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer
) -> None:
    page.part("jog-gripper-plus").scroll_into_view_if_needed()
    drive(record, lambda: fingers.press(1, "jog-gripper-plus"), lambda: fingers.lift(1))
    stop_from_elsewhere(server.url, "service")
    record.until_rest()


def test_a_button_does_not_outlive_its_element(
    page: OpenPage, fingers: Fingers, record: ArmRecord, server: RunningServer
) -> None:
    drive(record, lambda: fingers.press(1, "jog-wrist_flex-minus"), lambda: fingers.lift(1))
    choose_group(page, server, "gripper")
    fingers.lift(1)
    record.until_rest()
    choose_group(page, server, "arm")


def choose_group(page: OpenPage, server: RunningServer, group: str) -> None:
    publish(server.url, "/moveit_goal_group", "std_msgs/String", {"data": group})
    page.until_state(f"s.group === '{group}'")


def test_a_press_of_a_quarter_of_a_second_cancels_a_goal(
    page: OpenPage, fingers: Fingers, server: RunningServer
) -> None:
    page.open_panel("goals")
    with blocking.connect(server.url) as websocket:
        # Slow, so that statuses come all the while.
        for topic, type_name, msg in (
            (*SPEED_FACTOR, {"data": 0.02}),
            ("/moveit_goal_named", "std_msgs/String", {"data": "home"}),
            ("/moveit_goal_named", "std_msgs/String", {"data": "ready"}),
        ):
            websocket.send(json.dumps({"op": "publish", "topic": topic, "type": type_name, "msg": msg}))
        status = {"op": "subscribe", "topic": "/moveit_goal_status", "type": "diagnostic_msgs/DiagnosticStatus"}
        websocket.send(json.dumps(status))
        page.until_state("s.active_goals.length === 2 && s.active_goals.some(({ state }) => state === 'executing')")
        for goal_id in reversed([goal["id"] for goal in page.state("active_goals")]):
            page.part(f"cancel-{goal_id}").focus()
            fingers.press(1, f"cancel-{goal_id}")
            time.sleep(0.25)
            assert page.page.evaluate("document.activeElement.dataset.testid") == f"cancel-{goal_id}"
            fingers.lift(1)
            assert cancelled(websocket, goal_id)
        websocket.send(json.dumps({"op": "publish", "topic": "/arm/speed_factor", "msg": {"data": 1.0}}))


def cancelled(websocket: blocking.ClientConnection, goal_id: str) -> bool:
    """Wait for the answer of a goal; return true if it was cancelled."""
    while True:
        status = json.loads(websocket.recv(timeout=TIMEOUT_S))["msg"]
        values = values_of(status)
        if status["hardware_id"] == goal_id and values["state"] == "done":
            return values["code"] == "-7"


def test_stop_is_there_while_the_texts_of_the_language_do_not_come(tab: OpenPage, server: RunningServer) -> None:
    tab.open(server.port)
    tab.page.evaluate("localStorage.setItem('armbridge-language', 'de')")
    # Never answered.
    tab.page.route("**/assets/de.js", lambda _: None)
    tab.page.reload(wait_until="commit")
    tab.part("stop").wait_for()
    tab.page.unroute_all(behavior="ignoreErrors")
