"""Episodes: marking, frames and samples."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from server.datasets import samples as samples_module
from server.datasets.episodes import EPISODE_TOPIC, EPISODE_TYPE, START, Episode, Mark, episodes_of, parse_mark
from server.datasets.frames import LeftOutError, Tracks, frames_of, in_lerobot_units
from server.datasets.lerobot import QUANTILES, ImageStatistics
from server.datasets.marking import (
    DISCARD_SERVICE,
    MAX_WATCHED,
    NOT_RECORDED,
    START_SERVICE,
    STATE,
    STATE_TYPE,
    STOP_SERVICE,
    EpisodeServices,
)
from server.datasets.samples import JointSample, read_samples, series, times_s
from server.errors import RecordingError
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.graph import called, listen
from tests.server.datasets.conftest import JOINTS, Record, state, states
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


async def test_cameras_that_are_gone_make_room_for_another_where_as_many_are_watched_as_can_be() -> None:
    marked, client = Marked(), Node("client", remote=True)
    for number in range(MAX_WATCHED):
        marked.graph.advertise(client, f"/camera{number}", "sensor_msgs/Image")
    await marked.call(START_SERVICE, task="pick")
    marked.graph.remove(client)
    marked.graph.advertise(client, CAMERA, "sensor_msgs/Image")
    marked.services.look()
    assert (len(marked.graph.subscribers(CAMERA)), marked.graph.subscribers("/camera0")) == (1, [])


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
    nothing = f"episode 2 has begun, but {NOT_RECORDED}"
    assert await marked.call(START_SERVICE, task="") == (True, nothing)
    assert subscribed() == []


def test_marks_make_episodes() -> None:
    for marks, episodes in (
        ([], [Episode(0.0, 9.0, "")]),
        (
            [(1.0, "start pick the cube"), (3.0, "stop"), (4.0, "start"), (6.0, "stop")],
            [Episode(1.0, 3.0, "pick the cube"), Episode(4.0, 6.0, "")],
        ),
        ([(1.0, "start"), (2.0, "discard"), (3.0, "start"), (4.0, "stop")], [Episode(3.0, 4.0, "")]),
        # A discard between episodes drops the last one.
        ([(1.0, "start"), (2.0, "stop"), (3.0, "start"), (4.0, "stop"), (5.0, "discard")], [Episode(1.0, 2.0, "")]),
        ([(1.0, "start"), (2.0, "discard")], []),
    ):
        assert episodes_of(marks, 0.0, 9.0) == (episodes, [])


def test_a_mark_that_does_not_fit_is_said() -> None:
    for texts, count, sentence in (
        (["start"], 1, "was not stopped, and ends with the file"),
        (["start", "start", "stop"], 2, "within another"),
        (["stop"], 0, "has no start"),
        (["discard"], 0, "has no episode"),
        (["go"], 0, "data: must be 'start', 'start TASK', 'stop' or 'discard', not 'go'"),
        (["start " + "x" * 301], 0, "task: must have at most 300 characters, not 301"),
    ):
        episodes, (note,) = episodes_of(list(enumerate(texts, start=1)), 0.0, 9.0)
        assert len(episodes) == count
        assert sentence in note


def test_a_task_is_one_line() -> None:
    assert parse_mark(" start  pick\n the cube ") == Mark(START, "pick the cube")
    for mark in (Mark(START), Mark(START, "pick the cube")):
        assert parse_mark(mark.text) == mark


TIMES_S = np.arange(0.0, 4.0001, 0.02)
TRACKS = Tracks(TIMES_S, 0.1 * TIMES_S[:, None], None, None, {})
EPISODE = Episode(1.0, 2.0, "go")


def test_states_are_interpolated_at_a_fixed_rate_and_action_and_image_are_the_last_before_the_frame() -> None:
    late_s = TIMES_S + 0.005
    numbers = np.arange(len(late_s))
    tracks = replace(TRACKS, action_times_s=late_s, actions=numbers[:, None], image_times_s={"c": late_s})
    frames = frames_of(EPISODE, tracks, 10)
    assert (frames.count, frames.start_s) == (11, 1.0)
    assert frames.states[:, 0] == pytest.approx(0.1 + 0.01 * np.arange(11))
    for found in (frames.actions[:, 0], frames.images["c"]):
        assert found.tolist() == [49 + 5 * n for n in range(11)]
    assert frames_of(EPISODE, tracks, 30).states[:, 0] == pytest.approx(0.1 + 0.1 * np.arange(31) / 30)


GAP_S = np.delete(TIMES_S, np.flatnonzero((TIMES_S > 1.2) & (TIMES_S < 1.79)))

EARLY_S, LATE_S = TIMES_S[:70], TIMES_S[80:]
LEFT_OUT: list[tuple[dict[str, Any], str]] = [
    ({"state_times_s": GAP_S, "states": 0.1 * GAP_S[:, None]}, "the states have a gap of 0.6 s, 0.2 s after it begins"),
    ({"state_times_s": EARLY_S, "states": TRACKS.states[:70]}, "the states end 0.6 s before it does"),
    ({"image_times_s": {"/c": GAP_S}}, "the images on /c have a gap of 0.6 s, 0.2 s after it begins"),
    ({"image_times_s": {"/c": TIMES_S[:65]}}, "the images on /c have a gap of 0.7 s, 0.3 s after it begins"),
    ({"image_times_s": {"/c": np.array([])}}, "the images on /c are missing"),
    (
        {"action_times_s": LATE_S, "actions": TRACKS.states[80:], "action_name": "/a"},
        "the actions on /a begin 0.6 s after it does",
    ),
]


@pytest.mark.parametrize(("changes", "sentence"), LEFT_OUT)
def test_an_episode_with_something_missing_is_left_out_with_the_place(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(LeftOutError) as left_out:
        frames_of(EPISODE, replace(TRACKS, **changes), 10)
    assert str(left_out.value) == sentence


def test_an_episode_begins_where_everything_has_begun_and_of_one_frame_is_left_out() -> None:
    with pytest.raises(LeftOutError, match="it has 1 frames at 10 a second, and needs 2"):
        frames_of(Episode(1.0, 1.15, ""), TRACKS, 10)
    assert frames_of(Episode(2.0, 3.0, ""), replace(TRACKS, **LEFT_OUT[0][0]), 10).count == 10
    frames = frames_of(EPISODE, replace(TRACKS, image_times_s={"c": np.arange(1.3, 2.0, 0.1)}), 10)
    assert frames.start_s == pytest.approx(1.3)
    spoken_s = TIMES_S[(TIMES_S < 0.2) | (TIMES_S > 1.11)]
    frames = frames_of(EPISODE, replace(TRACKS, action_times_s=spoken_s, actions=spoken_s[:, None]), 10)
    assert frames.start_s == pytest.approx(1.12)
    assert frames.actions[:, 0] == pytest.approx(1.12 + np.arange(9) / 10)


def test_units_of_lerobot_are_degrees_from_the_zero_and_percent_of_the_grippers_range() -> None:
    positions = np.array([[np.pi / 2, 0.5, 0.5]])
    joints = ("shoulder_pan", "gripper", "left_gripper")
    ranges = {"gripper": (0.0, 2.0), "left_gripper": (-0.5, 1.5)}
    for zero_rad, degrees in ((0.0, 90.0), (np.pi / 4, 45.0)):
        zeros_rad = {"shoulder_pan": zero_rad, "gripper": 1.0}
        found = in_lerobot_units(positions, joints, ranges, zeros_rad)[0]
        assert found == pytest.approx([degrees, 25.0, 50.0])


def test_a_message_that_does_not_fit_its_type_is_counted_and_more_samples_than_fit_are_refused(
    recorded: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = state(0.5)._replace(octets=b"\0\1\0\0\7")
    assert read_samples(recorded([state(0.0), broken]), REGISTRY).unreadable == 1
    monkeypatch.setattr(samples_module, "MAX_SAMPLES", 20)
    with pytest.raises(RecordingError, match="must have at most 20 states, goals and images"):
        read_samples(recorded(states(1.0)), REGISTRY)


def test_stamps_take_the_jitter_off_and_the_difference_of_clocks_where_they_can_be_used() -> None:
    stamps = np.arange(100.0, 101.0, 0.02)
    late = np.tile([0.0, 0.004], 25)
    times = times_s(stamps + 5000.0 + late, stamps)
    assert np.diff(times) == pytest.approx(0.02)
    assert times[0] == pytest.approx(5100.002)
    for unusable in ([0.0, 0.0, 0.0], [1.0, 0.0, 3.0], [1.0, 2.0, 4.2]):
        assert times_s([11.0, 12.0, 13.0], unusable).tolist() == [11.0, 12.0, 13.0], unusable


def test_joints_are_found_by_name_in_any_order_and_increasing_times() -> None:
    rows = [
        JointSample(3.0, 0.0, ("gripper", "shoulder_pan"), (0.5, 0.3)),
        JointSample(1.0, 0.0, JOINTS, (0.1, 0.5)),
        JointSample(1.0, 0.0, JOINTS, (0.7, 0.5)),
        JointSample(2.0, 0.0, ("shoulder_pan",), (0.2,)),
        JointSample(2.5, 0.0, JOINTS, (float("nan"), 0.5)),
    ]
    times, positions = series(rows, JOINTS)
    assert times.tolist() == [1.0, 3.0]
    assert positions.tolist() == [[0.1, 0.5], [0.3, 0.5]]


def test_statistics_of_images_are_those_of_their_pixels_in_all_frames() -> None:
    images = np.random.default_rng(1).integers(0, 256, size=(2, 20, 30, 3), dtype=np.uint8)
    statistics = ImageStatistics()
    statistics.add(images[0], 3)
    other = ImageStatistics()
    other.add(images[1])
    statistics.merge(other)
    told = statistics.result()
    pixels = np.concatenate([images[:1]] * 3 + [images[1:]]).reshape(-1, 3) / 255.0
    assert told["count"] == [4]
    assert np.shape(told["mean"]) == (3, 1, 1)
    for name in ("min", "max", "mean", "std"):
        assert np.ravel(told[name]) == pytest.approx(getattr(pixels, name)(axis=0))
    for name, share in QUANTILES.items():
        assert np.ravel(told[name]) == pytest.approx(np.quantile(pixels, share, axis=0), abs=1 / 255)
