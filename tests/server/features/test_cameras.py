"""Cameras of a server with physics: orders to their process, what it renders, and its end."""

import asyncio
import logging
import math
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from harness.waiting import until
from protocol.publication import PublishedMessage
from robot.description.camera import Camera
from robot.messages import ArmState, Mode
from robot.physics.bodies import BodyState
from server.config import Settings
from server.datasets.rendered import CannotRender, LoadCameras, PublishedCamera, Render, Rendered
from server.features import cameras
from server.features.cameras import IDLE_S, MAX_FAILURES, SILENT_S, Cameras, cameras_of
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.services.description import TransformsTopics
from tests.helpers.graph import answered
from tests.helpers.moveit import REGISTRY, ROBOT, box, diff, held, pose, scene_state

LEVEL = (0.0, 0.0, 0.0, 1.0)
VIEW = [0.6, 0.0, 0.4, 0.0, 0.0, 0.0]
FRONT = PublishedCamera(Camera(frame="base_link", view=VIEW, depth=True), "/front/image/compressed")
WRIST = PublishedCamera(Camera(frame="gripper_link", view=VIEW, rate_hz=5.0), "/wrist/image/compressed")
PUBLISHED = "sensor_msgs/CompressedImage"
IMAGE = {"format": "jpeg", "data": "AA=="}


class FakeChild:
    """Process of the cameras; a test sends its answers and ends it."""

    ending = "exit code 1"

    def __init__(self, _started: object, received: Callable[[Any], None], exited: Callable[[], None], **_: int) -> None:
        self.answer, self.exit = received, exited
        self.sent: list[Any] = []
        self.killed = False

    async def connect(self) -> None:
        """Do nothing."""

    def send(self, message: object) -> None:
        self.sent.append(message)

    async def kill(self) -> None:
        self.killed = True


class Stage:
    """The feature, its scene and its processes, and the states that the arm sends."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, recorded: Path | None = None) -> None:
        self.children: list[FakeChild] = []
        self.now_s = 0.0
        monkeypatch.setattr(cameras, "Child", self._child)
        monkeypatch.setattr(cameras, "StartedChild", lambda _module: None)
        monkeypatch.setattr(cameras.time, "monotonic", lambda: self.now_s)
        self.graph, self.scene = Graph(REGISTRY), scene_state()
        self.physics = SimpleNamespace(body_states={})
        TransformsTopics(self.graph, ROBOT)
        context = SimpleNamespace(
            planning=SimpleNamespace(scene_state=self.scene),
            whole=SimpleNamespace(robot=ROBOT),
            graph=self.graph,
            settings=Settings.model_validate({"recording": {"file": recorded}}),
        )
        self.cameras = Cameras(cast(Any, context), cast(Any, self.physics), [FRONT, WRIST])
        self.published: list[PublishedMessage] = []

    def _child(self, *arguments: Any, **options: Any) -> FakeChild:
        self.children.append(FakeChild(*arguments, **options))
        return self.children[-1]

    def subscribe(self, topic: str, type_name: str = PUBLISHED) -> Node:
        node = Node("client")
        self.graph.subscribe(node, topic, type_name, Subscriber(self.published.append))
        return node

    async def watch(self, clock_s: float = 0.0) -> FakeChild:
        """Subscribe, and return the process that is ready."""
        self.subscribe(FRONT.topic)
        self.state(clock_s)
        await asyncio.sleep(0)
        self.children[-1].answer(Rendered())
        return self.children[-1]

    async def end_process(self) -> None:
        """End the process, and wait for the next one."""
        count = len(self.children)
        self.children[-1].exit()
        await until(lambda: len(self.children) == count + 1)
        await asyncio.sleep(0)

    def call(self, service: str, **request: Any) -> tuple[bool, str]:
        values = answered(self.graph, f"/simulation/{service}", **request).values
        return values["success"], values["message"]

    def state(self, clock_s: float, pan_rad: float = 0.3) -> None:
        state = ArmState(7.25, Mode.HOLDING, ("shoulder_pan",), position_rad=np.array([pan_rad]), clock_s=clock_s)
        self.cameras.on_state("", state)

    @property
    def images(self) -> list[str]:
        """Topics of what was published."""
        return [each.topic for each in self.published]

    @property
    def frames(self) -> dict[str, str]:
        """Parents of the latched frames."""
        latched = self.graph.latched("/tf_static")
        assert latched is not None
        return {each["child_frame_id"]: each["header"]["frame_id"] for each in latched.msg["transforms"]}

    @property
    def orders(self) -> list[Render]:
        return [each for each in self.children[-1].sent if isinstance(each, Render)]


@pytest.fixture
async def stage(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Stage]:
    made = Stage(monkeypatch)
    await made.cameras.start()
    yield made
    await made.cameras.stop()


async def test_images_are_rendered_at_their_rates_while_someone_subscribes_one_order_at_a_time(stage: Stage) -> None:
    stage.state(0.0)
    assert not stage.children, "nobody watches"
    client = stage.subscribe(FRONT.topic)
    stage.state(0.0)
    await asyncio.sleep(0)
    child = stage.children[0]
    assert child.sent == [LoadCameras(ROBOT, (FRONT, WRIST))]
    stage.state(0.0)
    assert not stage.orders, "before the process is ready"
    child.answer(Rendered())
    for tick in range(50):
        stage.state(0.02 * tick)
        stage.state(0.02 * tick)
        child.answer(Rendered([(FRONT.topic, IMAGE)]))
    assert [each.topics for each in stage.orders] == [[FRONT.topic]] * 15
    assert stage.cameras.observes_states
    stage.subscribe(WRIST.topic)
    stage.graph.unsubscribe(client, FRONT.topic)
    stage.state(1.0)
    stage.state(2.0)
    assert [each.topics for each in stage.orders[15:]] == [[WRIST.topic]], "an order before the last was answered"


async def test_the_info_of_a_camera_needs_no_process_and_comes_with_each_image(stage: Stage) -> None:
    stage.subscribe(FRONT.info_topic, "sensor_msgs/CameraInfo")
    for tick in range(50):
        stage.state(0.02 * tick)
    assert (stage.images, stage.children) == ([FRONT.info_topic] * 15, [])
    stamp = {"sec": 7, "nanosec": 250_000_000}
    assert stage.published[0].msg["header"] == {"stamp": stamp, "frame_id": "front_optical_frame"}
    child = await stage.watch(1.0)
    assert len(stage.images) == 15, "the process is not ready"
    stage.state(1.02)
    child.answer(Rendered([(FRONT.topic, IMAGE)]))
    assert stage.images[15:] == [FRONT.info_topic, FRONT.topic]


@pytest.mark.stepped_time
async def test_the_process_ends_a_while_after_the_last_subscriber_and_comes_back_with_the_next(stage: Stage) -> None:
    child = await stage.watch()
    for node in stage.graph.subscribers(FRONT.topic):
        stage.graph.unsubscribe(node, FRONT.topic)
    stage.now_s = IDLE_S
    stage.state(1.0)
    await asyncio.sleep(1.0)
    assert not child.killed
    stage.now_s = IDLE_S + 1.0
    stage.state(1.02)
    await asyncio.sleep(1.0)
    assert child.killed
    assert len(stage.children) == 1
    assert await stage.watch(2.0) is stage.children[1]


async def test_a_server_that_records_has_the_process_ready_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(monkeypatch, Path("run.mcap"))
    stage.state(0.0)
    await asyncio.sleep(0)
    assert len(stage.children) == 1
    await stage.cameras.stop()


async def test_a_service_adds_and_replaces_cameras(stage: Stage) -> None:
    child = await stage.watch()
    stage.subscribe("/front/depth/image", "sensor_msgs/Image")
    assert stage.frames["wrist_optical_frame"] == "gripper_link"
    assert len(stage.frames) > 2, "the arm's own fixed frames"
    added = stage.call("set_camera", name="top", view=[0.2, 0.0, 0.8, 0.2, 0.0, 0.0], width=64, depth=True)
    assert added == (True, "top is on /top/image/compressed, /top/camera_info, /top/depth/image")
    assert stage.call("set_camera", name="front", view=VIEW, frame="gripper_link", rate_hz=30.0)[0]
    stage.state(0.0)
    cameras = child.sent[-1].cameras
    assert {each.topic: (each.camera.frame, each.camera.width, each.camera.rate_hz) for each in cameras} == {
        FRONT.topic: ("gripper_link", 320, 30.0),
        WRIST.topic: ("gripper_link", 320, 5.0),
        "/top/image/compressed": ("base_link", 64, 15.0),
    }
    assert stage.graph.topic_type("/top/depth/image") is not None
    assert stage.graph.publishers("/front/depth/image") == []
    assert stage.frames["front_optical_frame"] == "gripper_link"
    child.answer(Rendered([("/front/depth/image", {})]))
    assert "/front/depth/image" not in stage.images, "rendered before its camera was replaced"


async def test_a_camera_that_cannot_be_is_refused(stage: Stage) -> None:
    for request_, sentence in (
        ({"name": "Top"}, "name must be at most 31 lower-case letters, digits and _, a letter first, not 'Top'"),
        ({"view": [0.0] * 6}, "view: the camera must look at another point than its own place, not [0.0, 0.0, 0.0, "),
        ({"frame": "hand"}, "frame: the arm has no link 'hand'"),
        ({"width": 2000}, "width: must be less than or equal to 1280, not 2000"),
        ({"height": 33}, "height: must be a multiple of 2, not 33"),
        ({"rate_hz": 1000.0}, "rate_hz: must be less than or equal to 60, not 1000.0"),
        ({"rate_hz": math.nan}, "rate_hz: must be less than or equal to 60, not nan"),
        ({"field_of_view_deg": -1.0}, "field_of_view_deg: must be greater than or equal to 5, not -1.0"),
    ):
        done, message = stage.call("set_camera", **{"name": "top", "view": VIEW, **request_})
        assert (done, message[: len(sentence)]) == (False, sentence)
        assert stage.graph.topic_type("/top/image/compressed") is None, request_


async def test_the_cameras_are_bounded_and_a_topic_of_another_type_is_refused(stage: Stage) -> None:
    stage.graph.advertise(Node("client", remote=True), "/top/camera_info", "std_msgs/String")
    assert not stage.call("set_camera", name="top", view=VIEW)[0]
    assert stage.graph.publishers("/top/image/compressed") == []
    assert all(stage.call("set_camera", name=f"camera{count}", view=VIEW)[0] for count in range(6))
    said = stage.call("set_camera", name="camera6", view=VIEW)
    assert said == (False, "there are 8 cameras at most: replace one, by its name")
    assert stage.call("set_camera", name="camera5", view=VIEW)[0], "in place of the one there is"


async def test_a_camera_sees_the_measured_joints_and_objects_where_the_physics_has_them(stage: Stage) -> None:
    joints = {joint.name: 0.0 for joint in ROBOT.movable_joints}
    red = {"id": "cube", "color": {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}}
    objects = [box("cube", at=pose(0.2, 0.1, 0.025)), box("wall", at=pose(0.4, 0.0, 0.1)), box("tool")]
    stage.scene.apply_diff(diff(world={"collision_objects": objects}, object_colors=[red]), joints)
    stage.scene.apply_diff(diff(robot_state={"attached_collision_objects": [held("tool")], "is_diff": True}), joints)
    stage.physics.body_states["cube"] = BodyState("cube", (0.2, 0.1, 0.3), LEVEL, held=True)
    await stage.watch()
    stage.state(0.0)
    scene = stage.orders[0].scene
    assert (scene.stamp_ns, scene.positions_rad) == (7_250_000_000, {"shoulder_pan": 0.3})
    assert scene.colors == {"cube": (1.0, 0.0, 0.0, 1.0)}
    seen = {body.name: (body.position_m, link) for body, link in scene.bodies}
    assert seen["cube"] == ((0.2, 0.1, 0.3), "")
    assert seen["wall"] == ((0.4, 0.0, 0.1), "")
    assert seen["tool"][1] == held("tool")["link_name"]
    shapes = next(body.shapes for body, _ in scene.bodies if body.name == "wall")
    stage.scene.apply_diff(diff(world={"collision_objects": [box("wall", at=pose(0.5, 0.0, 0.1))]}), joints)
    stage.children[0].answer(Rendered())
    stage.state(1.0)
    walls = [body for body, _ in stage.orders[1].scene.bodies if body.name == "wall"]
    assert [(body.position_m, body.shapes) for body in walls] == [((0.5, 0.0, 0.1), shapes)]


@pytest.mark.stepped_time
async def test_a_process_that_ends_is_started_again_a_few_times_and_an_image_makes_its_ends_forgotten(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    await stage.watch()
    for _ in range(3 * MAX_FAILURES):
        stage.children[-1].answer(Rendered([(FRONT.topic, IMAGE)]))
        await stage.end_process()
    for _ in range(2, MAX_FAILURES):
        await stage.end_process()
    started = len(stage.children)
    with caplog.at_level(logging.ERROR):
        stage.children[-1].exit()
        given_up = "the cameras show nothing: their process has ended 5 times in a row"
        await until(lambda: caplog.messages[-1:] == [given_up])
    stage.state(1.0)
    await asyncio.sleep(100.0)
    assert len(stage.children) == started
    assert all(child.killed for child in stage.children)


@pytest.mark.stepped_time
async def test_a_machine_that_cannot_render_gets_one_sentence(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        child = await stage.watch()
        child.answer(CannotRender("images need OpenGL off screen"))
        child.exit()
        stage.now_s = SILENT_S + 1.0
        stage.state(1.0)
        await asyncio.sleep(100.0)
    sentence = "the cameras show nothing: images need OpenGL off screen"
    assert caplog.messages == [sentence]
    assert stage.call("set_camera", name="top", view=VIEW) == (False, sentence)
    assert len(stage.children) == 1


@pytest.mark.stepped_time
async def test_a_silent_process_is_replaced(stage: Stage) -> None:
    child = await stage.watch()
    stage.state(0.0)
    stage.now_s = SILENT_S
    stage.state(1.0)
    await asyncio.sleep(0)
    assert not child.killed
    stage.now_s = SILENT_S + 1.0
    stage.state(1.02)
    await until(lambda: len(stage.children) == 2)
    assert child.killed


@pytest.mark.stepped_time
@pytest.mark.parametrize("silent_s", [0.0, SILENT_S + 1.0], ids=["in a restart", "after a rest"])
async def test_after_a_stop_no_process_is_started(stage: Stage, silent_s: float) -> None:
    child = await stage.watch()
    if not silent_s:
        child.exit()
    await stage.cameras.stop()
    # The arm sends states until it is stopped, after the cameras.
    stage.now_s = silent_s
    stage.state(1.0)
    await asyncio.sleep(100.0)
    assert len(stage.children) == 1
    assert child.killed


def test_an_arm_without_physics_has_none() -> None:
    context = SimpleNamespace(single_arms=[], graph=Graph(REGISTRY))
    assert cameras_of(cast(Any, context), []) == []
