from typing import Any

import pytest

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from server.datasets.episodes import EPISODE_TOPIC, EPISODE_TYPE, START, Episode, Mark, episodes_of, parse_mark
from server.datasets.marking import (
    DISCARD_SERVICE,
    MAX_WATCHED,
    START_SERVICE,
    STATE,
    STATE_TYPE,
    STOP_SERVICE,
    EpisodeServices,
)
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.graph import called, listen
from tests.server.recordings import REGISTRY


class Marked:
    """The services on a graph of their own, with a listener to the topic."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.recording = True
        self.graph = Graph(REGISTRY, wall_clock=lambda: self.now_s)
        self.texts: list[str] = []
        self.services = EpisodeServices(self.graph, lambda: self.recording, lambda: self.now_s)
        self.states = listen(self.graph, STATE, STATE_TYPE)
        self.graph.subscribe(Node("recorder"), EPISODE_TOPIC, EPISODE_TYPE, Subscriber(self._take))

    def _take(self, published: PublishedMessage) -> None:
        self.texts.append(published.msg["data"])

    async def call(self, service: str, **request: Any) -> tuple[bool, str]:
        values = (await called(self.graph, service, **request)).values
        return values["success"], values["message"]


async def test_the_services_publish_marks_that_fit_and_say_what_they_have_done() -> None:
    marked = Marked()
    assert await marked.call(STOP_SERVICE) == (False, f"no episode is in progress: {START_SERVICE} begins one")
    assert await marked.call(DISCARD_SERVICE) == (False, "there is no episode to discard")
    long = "task: must have at most 300 characters, not 301"
    assert await marked.call(START_SERVICE, task="x" * 301) == (False, long)
    assert await marked.call(START_SERVICE, task="pick the  cube") == (True, "episode 1 has begun")
    done, sentence = await marked.call(START_SERVICE, task="")
    assert (done, "an episode is in progress" in sentence) == (False, True)
    marked.now_s += 2.5
    assert await marked.call(STOP_SERVICE) == (True, "episode 1 has ended after 2.5 s")
    assert await marked.call(DISCARD_SERVICE) == (True, "the last episode is discarded; 0 are left")
    await marked.call(START_SERVICE, task="")
    assert marked.texts == ["start pick the cube", "stop", "discard", "start"]


CAMERA = "/wrist/image/compressed"


async def test_a_silent_camera_is_reported_as_soon_as_its_episode_ends(caplog: pytest.LogCaptureFixture) -> None:
    marked, camera = Marked(), Node("camera")
    marked.graph.advertise(camera, CAMERA, "sensor_msgs/CompressedImage")
    sentences = []
    for images_s in ([0.3, 0.3, 0.3], [0.3, 0.9], []):
        await marked.call(START_SERVICE, task="")
        for wait_s in images_s:
            marked.now_s += wait_s
            marked.graph.publish(camera, CAMERA, {})
        marked.now_s += 0.4
        if not images_s:
            # The camera is gone.
            marked.now_s += 1.0
            marked.graph.unadvertise(camera, CAMERA)
        sentences.append((await marked.call(STOP_SERVICE))[1])
    left_out = f"It would be left out of a dataset: {CAMERA} was silent for"
    assert sentences == [
        "episode 1 has ended after 1.3 s",
        f"episode 2 has ended after 1.6 s. {left_out} 0.9 s",
        f"episode 3 has ended after 1.4 s. {left_out} 1.4 s",
    ]
    assert f"episode 2 would be left out of a dataset: {CAMERA} was silent for 0.9 s" in caplog.text


async def test_topics_that_nobody_publishes_are_no_cameras_and_not_all_that_clients_make_up_are_watched() -> None:
    marked, client, commanded = Marked(), Node("client", remote=True), "/made_up_controller/controller_state"
    await marked.call(START_SERVICE, task="")

    def watched() -> int:
        marked.services.look()
        return sum(each["key"].startswith("rate_hz.") for each in marked.states[-1]["values"])

    marked.graph.subscribe(client, CAMERA, "sensor_msgs/Image", Subscriber(lambda _published: None))
    assert watched() == 0
    for number in range(2 * MAX_WATCHED):
        marked.graph.advertise(client, f"/camera{number}", "sensor_msgs/Image")
    marked.graph.advertise(client, commanded, "std_msgs/String")
    assert watched() == MAX_WATCHED
    assert marked.graph.subscribers(commanded) == []


# Intervals between images [s], their delay behind their stamps [s], and the problem.
TIMINGS: dict[str, tuple[list[float], float, str]] = {
    "even": ([0.1] * 10, 0.05, ""),
    "jitter": ([0.1, 0.15, 0.05] * 4, 0.0, ""),
    "uneven": ([0.05] * 9 + [0.4], 0.0, f"{CAMERA} is uneven: 11 images a second, but up to 0.40 s apart"),
    "late": ([0.1] * 10, 0.3, f"{CAMERA} is late: its images come 0.3 s after their stamps"),
    "silent": ([0.1, 0.1, 0.7], 0.0, ""),
    "none": ([], 0.0, f"{CAMERA} is silent for 0.6 s"),
}


@pytest.mark.parametrize(("intervals_s", "delay_s", "problem"), TIMINGS.values(), ids=TIMINGS.keys())
async def test_a_camera_that_is_late_or_uneven_is_reported_while_the_episode_is_recorded(
    intervals_s: list[float], delay_s: float, problem: str, caplog: pytest.LogCaptureFixture
) -> None:
    marked, camera = Marked(), Node("camera")
    await marked.call(START_SERVICE, task="pick")
    # A camera may begin after the episode.
    marked.graph.advertise(camera, CAMERA, "sensor_msgs/CompressedImage")
    marked.services.look()
    for wait_s in intervals_s:
        marked.now_s += wait_s
        stamp = Stamp.from_seconds(marked.now_s - delay_s).as_message()
        marked.graph.publish(camera, CAMERA, {"header": {"stamp": stamp, "frame_id": ""}})
    marked.now_s += 0.0 if intervals_s else 0.6
    for _ in range(2):
        marked.services.look()
    state = marked.states[-1]
    values = {each["key"]: each["value"] for each in state["values"]}
    assert (state["message"], state["level"]) == (problem, 1 if problem else 0)
    assert (values["task"], values["recording"], values["episodes"]) == ("pick", "true", "0")
    assert caplog.text.count("episode 1: ") == (1 if problem else 0)
    await marked.call(STOP_SERVICE)
    ended = {each["key"]: each["value"] for each in marked.states[-1]["values"]}
    assert (ended["task"], ended["episode_s"], ended["episodes"]) == ("", "", "1")
    assert ended["lengths_s"] == f"{marked.now_s - 100.0:.1f}"


async def test_the_services_know_the_marks_of_clients(caplog: pytest.LogCaptureFixture) -> None:
    marked = Marked()
    client = Node("client", remote=True)
    marked.graph.advertise(client, EPISODE_TOPIC, EPISODE_TYPE)
    marked.graph.publish(client, EPISODE_TOPIC, {"data": "start"})
    assert (await marked.call(STOP_SERVICE))[0]
    marked.graph.publish(client, EPISODE_TOPIC, {"data": "go"})
    assert "must be 'start', 'start TASK', 'stop' or 'discard', not 'go'" in caplog.text


async def test_states_and_commands_are_subscribed_to_while_an_episode_is_recorded_and_else_the_answer_says_so() -> None:
    marked, arm = Marked(), Node("arm")
    commanded = "/arm_controller/controller_state"
    marked.graph.advertise(arm, "/joint_states", "sensor_msgs/JointState")
    marked.graph.advertise(arm, commanded, "control_msgs/JointTrajectoryControllerState")
    marked.graph.advertise(arm, "/other", "std_msgs/String")

    def subscribed() -> list[str]:
        return [name for name in ("/joint_states", commanded, "/other") if marked.graph.subscribers(name)]

    assert subscribed() == []
    await marked.call(START_SERVICE, task="")
    assert subscribed() == ["/joint_states", commanded]
    await marked.call(STOP_SERVICE)
    assert subscribed() == []
    marked.recording = False
    nothing = "episode 2 has begun, but this server records nothing (armbridge serve --record FILE.mcap)"
    assert await marked.call(START_SERVICE, task="") == (True, nothing)
    assert subscribed() == []


@pytest.mark.parametrize(
    ("marks", "episodes"),
    [
        ([], [Episode(0.0, 9.0, "")]),
        (
            [(1.0, "start pick the cube"), (3.0, "stop"), (4.0, "start"), (6.0, "stop")],
            [Episode(1.0, 3.0, "pick the cube"), Episode(4.0, 6.0, "")],
        ),
        ([(1.0, "start"), (2.0, "discard"), (3.0, "start"), (4.0, "stop")], [Episode(3.0, 4.0, "")]),
        # A discard between episodes drops the last one.
        ([(1.0, "start"), (2.0, "stop"), (3.0, "start"), (4.0, "stop"), (5.0, "discard")], [Episode(1.0, 2.0, "")]),
        ([(1.0, "start"), (2.0, "discard")], []),
    ],
)
def test_marks_make_episodes(marks: list[tuple[float, str]], episodes: list[Episode]) -> None:
    assert episodes_of(marks, 0.0, 9.0) == (episodes, [])


@pytest.mark.parametrize(
    ("texts", "count", "sentence"),
    [
        (["start"], 1, "was not stopped, and ends with the file"),
        (["start", "start", "stop"], 2, "within another"),
        (["stop"], 0, "has no start"),
        (["discard"], 0, "has no episode"),
        (["go"], 0, "data: must be 'start', 'start TASK', 'stop' or 'discard', not 'go'"),
        (["start " + "x" * 301], 0, "task: must have at most 300 characters, not 301"),
    ],
)
def test_a_mark_that_does_not_fit_is_said(texts: list[str], count: int, sentence: str) -> None:
    episodes, (note,) = episodes_of(list(enumerate(texts, start=1)), 0.0, 9.0)
    assert len(episodes) == count
    assert sentence in note


def test_a_task_is_one_line() -> None:
    assert parse_mark(" start  pick\n the cube ") == Mark(START, "pick the cube")
    for mark in (Mark(START), Mark(START, "pick the cube")):
        assert parse_mark(mark.text) == mark
