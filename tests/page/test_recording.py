"""Episodes, leader and policy on the page; the judge is the file that the server records."""

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
from websockets.sync.client import connect

from harness.page import SHARED, OpenPage
from harness.server import FAST, RunningServer
from harness.waiting import join
from protocol.codecs import cdr
from server.errors import RecordingError
from server.interfaces import load_registry
from server.recording.reading import messages
from tests.helpers.messages import time_message
from tests.page.test_what_is_offered import TOPIC, TYPE, picture

LEADER = "/leader/joint_states"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recording") / "run.mcap"


@pytest.fixture(scope="module")
def server(recording: Path, settings: dict[str, str]) -> Iterator[RunningServer]:
    with RunningServer(f"--port 0 --record {recording}", settings={**settings, **FAST, **SHARED}) as running:
        yield running


@pytest.fixture
def panel(page: OpenPage) -> OpenPage:
    page.open_panel("recording", "episodes", "leader", "policy")
    return page


def recorded(recording: Path, topic: str) -> list[dict[str, Any]]:
    """Return the messages of a topic that are in the file by now."""
    registry = load_registry(())
    try:
        found = [each for each in messages(recording) if each.topic == topic]
    except RecordingError:
        return []
    return [cdr.deserialize(registry, each.type_name, each.octets) for each in found]


@contextmanager
def published(
    server: RunningServer, topic: str, type_name: str, period_s: float, delay_s: float = 0.0
) -> Iterator[None]:
    """Publish images, or joint states that swing, with stamps of some time ago."""
    ended = Event()

    def run() -> None:
        with connect(server.url) as client:
            client.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name}))
            while not ended.wait(period_s):
                swing = {"name": ["shoulder_pan"], "position": [0.2 * math.sin(time.monotonic())]}
                msg = {"header": {"stamp": time_message(time.time() - delay_s), "frame_id": ""}}
                msg |= picture(32, "jpeg") if type_name == TYPE else swing
                client.send(json.dumps({"op": "publish", "topic": topic, "msg": msg}))

    thread = Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        join(thread)


def test_episodes_are_started_kept_and_dropped_by_buttons_and_lerobots_keys(panel: OpenPage, recording: Path) -> None:
    def marks() -> list[str]:
        return [each["data"] for each in recorded(recording, "/dataset/episode")]

    def start(task: str) -> None:
        panel.part("episode-task").fill(task)
        panel.part("episode-start").click()
        panel.part("episode-now").wait_for()

    start("pick the cube")
    assert "pick the cube" in panel.part("episode-now").inner_text()
    # An arrow in the text moves the cursor.
    panel.part("episode-task").press("ArrowLeft")
    panel.part("episode-keep").click()
    panel.part("episode-now").wait_for(state="hidden")
    panel.wait(lambda: marks()[-2:] == ["start pick the cube", "stop"])
    for key, mark in (("ArrowRight", "stop"), ("ArrowLeft", "discard"), ("Escape", "stop")):
        start(key)
        panel.part("episode-count").click()
        panel.page.keyboard.press(key)
        panel.part("episode-now").wait_for(state="hidden")
        panel.wait(lambda: marks()[-2:] == [f"start {key}", mark])  # noqa: B023 - at once
    panel.wait(lambda: panel.part("episode-count").inner_text().startswith("Episodes: 3. "))
    panel.part("episode-drop").click()
    panel.wait(lambda: panel.part("episode-count").inner_text().startswith("Episodes: 2. "))
    assert panel.part("recording-off").is_hidden()


def test_a_camera_has_its_rate_and_its_delay_is_reported_during_the_episode(
    panel: OpenPage, server: RunningServer, recording: Path
) -> None:
    with published(server, TOPIC, TYPE, 0.1, delay_s=3.0):
        panel.part("episode-start").click()
        panel.wait(lambda: f"{TOPIC} is late: its images come" in panel.part("recording-problem").inner_text())
        panel.wait(lambda: panel.part("recording-cameras").inner_text().startswith(f"{TOPIC}: "))
        panel.part("episode-drop").click()
        panel.wait(lambda: panel.part("recording-problem").inner_text() == "")
    panel.wait(lambda: any("is late" in each["message"] for each in recorded(recording, "/dataset/state")))


def test_a_leader_is_followed_and_let_go(panel: OpenPage, server: RunningServer, recording: Path) -> None:
    def phases() -> list[str]:
        return [each["phase"] for each in recorded(recording, "/teleop/state") if each["leader"] == LEADER]

    def press(button: str) -> bool:
        # On a starved machine the leader may be silent for too long, and must be followed again. In one step, since the
        # button is hidden as soon as the following begins.
        return bool(panel.part(button).evaluate("each => !each.hidden && !each.disabled && (each.click(), true)"))

    with published(server, LEADER, "sensor_msgs/JointState", 0.03):
        panel.wait(lambda: [press("leader-look")] and panel.part("leader-on").is_enabled())
        panel.wait(lambda: [press("leader-on")] and "following" in phases())
        press("leader-off")
        panel.part("leader-on").wait_for()
        panel.wait(lambda: phases()[-1] == "idle")


def test_a_policy_is_paused_resumed_and_stopped(panel: OpenPage, recording: Path) -> None:
    def phase() -> str | None:
        states = recorded(recording, "/arm/chunks/state")
        return next((each["value"] for each in states[-1]["values"] if each["key"] == "phase"), None)

    panel.wait(lambda: panel.part("policy-state").inner_text() == "no chunk is followed")
    panel.part("policy-pause").click()
    panel.part("policy-resume").wait_for()
    panel.wait(lambda: phase() == "paused")
    panel.part("policy-resume").click()
    panel.wait(lambda: panel.part("policy-state").inner_text() == "the next chunk is followed")
    panel.part("policy-stop").click()
    panel.wait(lambda: panel.part("policy-state").inner_text() == "the policy is stopped")
    panel.wait(lambda: phase() == "idle")
