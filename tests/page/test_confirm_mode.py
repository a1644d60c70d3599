"""Confirm mode on the page: a goal of another client waits until a person confirms or discards it."""

import json
import time

from websockets.sync import client as blocking

from harness.page import DESKTOP, SHARED, SIZES, OpenPage
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.arm_record import MOVED_RAD, arm_record

SETTINGS = SHARED | {"ARMBRIDGE_GOALS__CONFIRM": "true"}

PREEMPTED, SUCCESS = -7, 1


def test_a_goal_is_discarded_or_confirmed_by_a_person(page: OpenPage, server: RunningServer) -> None:
    assert page.part("confirm").is_hidden()
    with blocking.connect(server.url) as client, arm_record(server.url) as record:
        subscription = {"topic": "/moveit_goal_result", "type": "moveit_msgs/MoveItErrorCodes"}
        client.send(json.dumps({"op": "subscribe", **subscription}))
        for control, code in (("discard", PREEMPTED), ("confirm", SUCCESS)):
            began_s = time.time()
            message = {"topic": "/moveit_goal_named", "type": "std_msgs/String", "msg": {"data": "ready"}}
            client.send(json.dumps({"op": "publish", **message}))
            page.until_text("state-pill", "CONFIRM?")
            page.until_state("s.plan.trajectory !== null")
            page.until_text("next-step", "Confirm or Discard")
            assert not page.offers("go")
            assert cut_sizes(page) == []
            page.part(control).click()
            assert json.loads(client.recv(timeout=TIMEOUT_S))["msg"]["val"] == code
            assert (record.way_rad(began_s) > MOVED_RAD) is (control == "confirm")
            page.until("document.querySelector('[data-testid=confirm]').hidden")


def cut_sizes(page: OpenPage) -> list[tuple[int, int]]:
    """Sizes of the window at which the sentence beside the buttons is not shown whole."""
    found = []
    for width, height in SIZES:
        page.page.set_viewport_size({"width": width, "height": height})
        if page.part("message").evaluate("message => message.scrollHeight > message.clientHeight + 1"):
            found.append((width, height))
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    return found
