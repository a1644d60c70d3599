"""Cameras of a server with physics: orders to their process, what it renders, and its end."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from harness.waiting import until
from protocol.registry import Registry
from robot.description.camera import Camera
from robot.messages import ArmState, Mode
from robot.physics.bodies import BodyState
from server.datasets.rendered import CannotRender, LoadCameras, PublishedCamera, Render, Rendered
from server.features import cameras
from server.features.cameras import MAX_FAILURES, SILENT_S, Cameras, cameras_of
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.services.description import TransformsTopics
from tests.helpers.moveit import ROBOT, box, diff, held, pose, scene_state

LEVEL = (0.0, 0.0, 0.0, 1.0)
VIEW = (0.6, 0.0, 0.4, 0.0, 0.0, 0.0)
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

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.children: list[FakeChild] = []
        self.now_s = 0.0
        monkeypatch.setattr(cameras, "Child", self._child)
        monkeypatch.setattr(cameras, "StartedChild", lambda _module: None)
        monkeypatch.setattr(cameras.time, "monotonic", lambda: self.now_s)
        self.graph, self.scene = Graph(Registry.load()), scene_state()
        self.physics = SimpleNamespace(body_states={})
        TransformsTopics(self.graph, ROBOT, 50.0)
        planning = SimpleNamespace(scene_state=self.scene)
        context = SimpleNamespace(planning=planning, whole=SimpleNamespace(robot=ROBOT), graph=self.graph)
        self.cameras = Cameras(cast(Any, context), cast(Any, self.physics), [FRONT, WRIST])
        self.images: list[str] = []

    def _child(self, *arguments: Any, **options: Any) -> FakeChild:
        self.children.append(FakeChild(*arguments, **options))
        return self.children[-1]

    def subscribe(self, topic: str, type_name: str = PUBLISHED) -> Node:
        node = Node("client")
        self.graph.subscribe(node, topic, type_name, Subscriber(lambda published: self.images.append(published.topic)))
        return node

    def state(self, clock_s: float, pan_rad: float = 0.3) -> None:
        state = ArmState(7.25, Mode.HOLDING, ("shoulder_pan",), position_rad=np.array([pan_rad]), clock_s=clock_s)
        self.cameras.on_state("", state)

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
    child = stage.children[0]
    assert child.sent == [LoadCameras(ROBOT, [FRONT, WRIST])]
    client = stage.subscribe(FRONT.topic)
    stage.state(0.0)
    assert not stage.orders, "before the process is ready"
    child.answer(Rendered())
    for tick in range(50):
        stage.state(0.02 * tick)
        stage.state(0.02 * tick)
        child.answer(Rendered([(FRONT.topic, IMAGE)]))
    assert [each.topics for each in stage.orders] == [[FRONT.topic, FRONT.info_topic]] * 15
    assert stage.cameras.observes_states
    stage.subscribe("/wrist/camera_info", "sensor_msgs/CameraInfo")
    stage.graph.unsubscribe(client, FRONT.topic)
    stage.state(1.0)
    stage.state(2.0)
    assert [each.topics for each in stage.orders[15:]] == [[WRIST.info_topic]], "an order before the last was answered"


async def test_an_arm_whose_clock_starts_again_is_seen_at_once(stage: Stage) -> None:
    stage.subscribe(FRONT.topic)
    for clock_s in (100.0, 1.0, 1.02, 1.08):
        stage.children[0].answer(Rendered())
        stage.state(clock_s)
    assert len(stage.orders) == 3


async def test_a_camera_sees_the_measured_joints_and_objects_where_the_physics_has_them(stage: Stage) -> None:
    joints = {joint.name: 0.0 for joint in ROBOT.movable_joints}
    red = {"id": "cube", "color": {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}}
    objects = [box("cube", at=pose(0.2, 0.1, 0.025)), box("wall", at=pose(0.4, 0.0, 0.1)), box("tool")]
    stage.scene.apply_diff(diff(world={"collision_objects": objects}, object_colors=[red]), joints)
    stage.scene.apply_diff(diff(robot_state={"attached_collision_objects": [held("tool")], "is_diff": True}), joints)
    stage.physics.body_states["cube"] = BodyState("cube", (0.2, 0.1, 0.3), LEVEL, held=True)
    stage.subscribe(FRONT.topic)
    stage.children[0].answer(Rendered())
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


async def test_images_are_published_and_their_frames_stand_beside_the_arms_fixed_frames(stage: Stage) -> None:
    stage.subscribe(FRONT.topic)
    stage.children[0].answer(Rendered([(FRONT.topic, IMAGE)]))
    assert stage.images == [FRONT.topic]
    latched = stage.graph.latched("/tf_static")
    assert latched is not None
    frames = {each["child_frame_id"]: each["header"]["frame_id"] for each in latched.msg["transforms"]}
    assert frames["wrist_optical_frame"] == "gripper_link"
    assert len(frames) > 2, "the arm's own fixed frames"


@pytest.mark.stepped_time
async def test_a_process_that_ends_is_started_again_a_few_times(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.subscribe(FRONT.topic)
    stage.children[-1].answer(Rendered([(FRONT.topic, IMAGE)]))
    for count in range(1, MAX_FAILURES):
        stage.children[-1].exit()
        await until(lambda count=count: len(stage.children) == count + 1)
        await asyncio.sleep(0)
    with caplog.at_level(logging.ERROR):
        stage.children[-1].exit()
        await until(
            lambda: caplog.messages[-1:] == ["the cameras show nothing: their process has ended 5 times in a row"]
        )
    stage.state(1.0)
    assert len(stage.children) == MAX_FAILURES
    assert all(child.killed for child in stage.children)


@pytest.mark.stepped_time
async def test_an_image_makes_the_ends_before_it_forgotten(stage: Stage) -> None:
    for count in range(1, 3 * MAX_FAILURES):
        stage.children[-1].answer(Rendered([(FRONT.topic, IMAGE)]))
        stage.children[-1].exit()
        await until(lambda count=count: len(stage.children) == count + 1)
        await asyncio.sleep(0)


@pytest.mark.stepped_time
async def test_a_machine_that_cannot_render_gets_one_sentence(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        stage.children[0].answer(CannotRender("images need OpenGL off screen"))
        stage.children[0].exit()
        stage.now_s = SILENT_S + 1.0
        stage.state(1.0)
        await asyncio.sleep(100.0)
    assert [each.message for each in caplog.records] == ["the cameras show nothing: images need OpenGL off screen"]
    assert len(stage.children) == 1


@pytest.mark.stepped_time
async def test_a_silent_process_is_replaced(stage: Stage) -> None:
    stage.now_s = SILENT_S
    stage.state(1.0)
    assert not stage.children[0].killed
    stage.now_s = SILENT_S + 1.0
    stage.state(1.02)
    await until(lambda: len(stage.children) == 2)
    assert stage.children[0].killed


@pytest.mark.stepped_time
@pytest.mark.parametrize("silent_s", [0.0, SILENT_S + 1.0], ids=["in a restart", "after a rest"])
async def test_after_a_stop_no_process_is_started(stage: Stage, silent_s: float) -> None:
    if not silent_s:
        stage.children[0].exit()
    await stage.cameras.stop()
    # The arm sends states until it is stopped, after the cameras.
    stage.now_s = silent_s
    stage.state(1.0)
    await asyncio.sleep(100.0)
    assert len(stage.children) == 1


def test_an_arm_without_physics_or_cameras_has_none() -> None:
    context = SimpleNamespace(single_arms=[], graph=Graph(Registry.load()))
    assert cameras_of(cast(Any, context), []) == []
