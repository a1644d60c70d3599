"""The planning scene as the world of a simulated arm: bodies out, poses and dropped objects back."""

import asyncio
import json
import logging
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from protocol.errors import MessageError
from robot.messages import ArmState, Mode, PauseSimulation
from robot.physics.bodies import MAX_BODIES, MAX_HULL_CORNERS, BodyShape, BodyState, BodyStates, SetBodies
from server.config import NamedArmSettings, Settings
from server.errors import ConfigurationError
from server.features.physics import DROPPED_AFTER_S, MAX_STEPS, RELEASED_AFTER_S, ArmWorld, Physics, body_of, read_world
from server.graph.permissions import Node, Role, Rule
from server.graph.topics import Graph, LocalGraph
from tests.helpers.graph import answered
from tests.helpers.moveit import REGISTRY, ROBOT, box, collision_object, current_state, diff, held, pose, scene_state

LEVEL = (0.0, 0.0, 0.0, 1.0)
FINGERS = ("gripper_link", "moving_jaw_so101_v1_link")
STAMP_S = 1000.0


class PhysicalArm:
    """An arm that keeps the bodies that it is sent, and the pauses."""

    def __init__(self) -> None:
        self.sent: list[SetBodies] = []
        self.pauses: list[PauseSimulation] = []

    def simulate(self, command: Any) -> None:
        (self.sent if isinstance(command, SetBodies) else self.pauses).append(command)

    @property
    def bodies(self) -> dict[str, Any]:
        return {each.name: each for each in self.sent[-1].bodies}


class Stage:
    """Scene, arms and feature, and the states that the arms send."""

    def __init__(self, placed: dict[str, tuple[NamedArmSettings, Any]] | None = None, **simulation: Any) -> None:
        self.scene, self.graph, self.clock_s = scene_state(), Graph(REGISTRY), STAMP_S
        settings = Settings.model_validate({"simulation": {"kind": "physics", **simulation}})
        self.arms: dict[str, PhysicalArm] = {}
        worlds = []
        for name, (own, robot) in (placed or {"": (settings.arm, ROBOT)}).items():
            self.arms[name], served = PhysicalArm(), SimpleNamespace(settings=own)
            arm = SimpleNamespace(name=name, robot=robot, graph=LocalGraph(self.graph, name), served=served)
            worlds.append(ArmWorld(cast(Any, arm), cast(Any, self.arms[name])))
        planning, whole = SimpleNamespace(scene_state=self.scene, current=current_state()), SimpleNamespace(robot=ROBOT)
        context = SimpleNamespace(planning=planning, whole=whole, graph=self.graph, settings=settings)
        self.physics = Physics(cast(Any, context), worlds)

    @property
    def arm(self) -> PhysicalArm:
        return self.arms[""]

    def apply(self, *objects: dict[str, Any], **fields: Any) -> None:
        message = diff(world={"collision_objects": list(objects)}, **fields) if objects else diff(**fields)
        self.scene.apply_diff(message, {joint.name: 0.0 for joint in ROBOT.movable_joints})

    def attach(self, name: str, **fields: Any) -> None:
        attached = [held(name, **{"touch_links": FINGERS, **fields})]
        self.apply(robot_state={"is_diff": True, "attached_collision_objects": attached})

    def call(self, service: str, **request: Any) -> tuple[bool, str]:
        values = answered(self.graph, service, **request).values
        return values["success"], values["message"]

    async def answer(self, service: str, *states: int | None, **request: Any) -> tuple[bool, str]:
        """Call a service that waits for the arms, which report these numbers of single ticks meanwhile."""
        answers: list[Any] = []
        self.graph.services.call(Node("client"), service, request, answers.append)
        for ticks in states:
            for name in self.arms:
                await asyncio.sleep(0)
                assert not answers
                self.report(arm=name, after_s=0.0, ticks=ticks)
        while not answers:
            await asyncio.sleep(0)
        return answers[0].values["success"], answers[0].values["message"]

    def report(
        self,
        *bodies: BodyState,
        arm: str = "",
        after_s: float = 0.2,
        gripper_rad: float | None = 0.0,
        version: int | None = None,
        ticks: int | None = None,
        mode: Mode = Mode.HOLDING,
    ) -> None:
        self.clock_s += after_s
        sent = self.arms[arm].sent
        moved = BodyStates(sent[-1].version if version is None else version, bodies) if bodies else None
        state = ArmState(
            STAMP_S,
            mode,
            ("shoulder_pan", "gripper"),
            goal_rad=None if gripper_rad is None else np.array([0.0, gripper_rad]),
            clock_s=self.clock_s,
            bodies=moved,
            stepped_ticks=ticks,
        )
        self.physics.on_state(arm, state)

    def position(self, name: str) -> tuple[float, float, float]:
        return self.scene.contents.objects[name].pose.position_m

    def movers(self) -> dict[str, bool]:
        return {name: arm.bodies["cube"].movable for name, arm in self.arms.items()}

    def seen(self) -> list[Any]:
        """Where the cube is from the foot of each arm [m]."""
        return [pytest.approx(arm.bodies["cube"].position_m) for arm in self.arms.values()]


@pytest.fixture
async def stage() -> Stage:
    made = Stage()
    made.apply(box("cube", at=pose(0.2, 0.1, 0.025)), box("wall", at=pose(0.4, 0.0, 0.1)))
    return made


def moved(z: float, *, held: bool = False) -> BodyState:
    return BodyState("cube", (0.2, 0.1, z), LEVEL, held)


async def test_each_change_of_the_scene_is_sent_once_and_nothing_is_movable_at_first(stage: Stage) -> None:
    assert set(stage.arm.bodies) == {"cube", "wall"}
    assert not any(each.movable for each in stage.arm.bodies.values())
    assert stage.arm.bodies["cube"].shapes[0].size_m == (0.025, 0.025, 0.025)
    sent = len(stage.arm.sent)
    stage.apply(name="another name")
    assert len(stage.arm.sent) == sent
    stage.apply({"id": "wall", "operation": 1})
    assert set(stage.arm.bodies) == {"cube"}


async def test_a_movable_object_follows_its_body_without_being_sent_again(stage: Stage) -> None:
    assert stage.call("/simulation/set_body", id="cube", movable=True, mass=0.05) == (True, "cube can be moved")
    assert (stage.arm.bodies["cube"].movable, stage.arm.bodies["cube"].mass_kg) == (True, 0.05)
    sent = len(stage.arm.sent)
    stage.report(moved(0.08))
    assert stage.position("cube") == (0.2, 0.1, 0.08)
    stage.report(moved(0.09), after_s=0.02)
    assert stage.position("cube") == (0.2, 0.1, 0.08), "more than ten changes of the scene a second"
    stage.report(after_s=0.1)
    assert stage.position("cube") == (0.2, 0.1, 0.09)
    version = stage.scene.scene.version
    stage.report(moved(0.0901))
    assert stage.scene.scene.version == version, "a new scene for a body that did not move"
    stage.report(moved(0.07), ticks=0)
    stage.report(moved(0.06), after_s=0.01, ticks=1)
    assert stage.position("cube") == (0.2, 0.1, 0.06), "a step of a paused simulation"
    assert len(stage.arm.sent) == sent


@pytest.mark.parametrize(
    ("change", "at"),
    [
        ({"id": "cube", "operation": 3, "pose": pose(0.1, 0.2, 0.025)}, (0.1, 0.2, 0.025)),
        (box("cube", at=pose(0.2, 0.1, 0.025)), (0.2, 0.1, 0.025)),
    ],
    ids=["moved", "added again"],
)
async def test_a_body_that_has_moved_is_put_where_a_client_says_and_older_reports_do_not_take_it_back(
    stage: Stage, change: dict[str, Any], at: tuple[float, float, float]
) -> None:
    stage.call("/simulation/set_body", id="cube", movable=True)
    stage.report(moved(0.08))
    before = stage.arm.sent[-1].version
    stage.apply(change)
    assert stage.arm.bodies["cube"].position_m == at
    assert stage.arm.sent[-1].placed == {"cube": (at, LEVEL)}
    stage.report(moved(0.07), version=before)
    assert stage.position("cube") == at


def grip(stage: Stage) -> None:
    stage.call("/simulation/set_body", id="cube", movable=True)
    stage.report(moved(0.08, held=True))
    stage.attach("cube")
    assert "cube" in stage.scene.contents.attached


async def test_an_object_is_attached_until_it_is_dropped(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    grip(stage)
    assert stage.arm.bodies["cube"].movable
    for _ in range(20):
        stage.report(moved(0.1, held=True))
    stage.report(moved(0.02), after_s=DROPPED_AFTER_S - 0.1)
    assert "cube" in stage.scene.contents.attached
    sent = len(stage.arm.sent)
    with caplog.at_level(logging.WARNING):
        stage.report(after_s=0.2)
    assert "cube" not in stage.scene.contents.attached
    assert stage.position("cube") == (0.2, 0.1, 0.02)
    assert caplog.messages == ["the gripper does not hold 'cube': it is at x 0.200, y 0.100, z 0.020 m"]
    assert len(stage.arm.sent) == sent


async def test_a_gripper_that_opens_leaves_its_client_the_time_to_detach(stage: Stage) -> None:
    grip(stage)
    stage.report(moved(0.02), after_s=0.1, gripper_rad=1.0)
    stage.report(after_s=DROPPED_AFTER_S + 0.5, gripper_rad=1.0)
    assert "cube" in stage.scene.contents.attached
    stage.report(after_s=RELEASED_AFTER_S, gripper_rad=1.0)
    assert "cube" not in stage.scene.contents.attached


async def test_a_detached_object_is_where_its_body_is(stage: Stage) -> None:
    grip(stage)
    sent = len(stage.arm.sent)
    stage.attach("cube", operation=1)
    stage.report(moved(0.03))
    assert stage.position("cube") == (0.2, 0.1, 0.03)
    assert len(stage.arm.sent) == sent


async def test_a_movable_object_is_put_somewhere_and_a_reset_puts_it_back_each_out_of_the_fingers(stage: Stage) -> None:
    grip(stage)
    assert stage.call("/simulation/set_pose", id="cube", pose=pose(0.1, 0.2, 0.3)) == (True, "cube is put there")
    assert (stage.position("cube"), stage.scene.contents.attached) == ((0.1, 0.2, 0.3), {})
    assert stage.arm.sent[-1].placed == {"cube": ((0.1, 0.2, 0.3), LEVEL)}
    stage.attach("cube")
    assert stage.call("/simulation/reset") == (True, "put back: cube")
    assert (stage.position("cube"), stage.scene.contents.attached) == ((0.2, 0.1, 0.025), {})
    assert stage.arm.sent[-1].placed == {"cube": ((0.2, 0.1, 0.025), LEVEL)}


async def test_a_pause_and_its_steps_are_answered_when_the_arm_has_done_them(stage: Stage) -> None:
    still = True, "the time of the simulation stands still"
    assert await stage.answer("/simulation/pause", None, 0, data=True) == still
    assert await stage.answer("/simulation/step", 0, 2, 3, steps=3) == (True, "3 of 3 steps are done")
    assert await stage.answer("/simulation/step", 4, None, steps=3) == (False, "0 of 3 steps are done")
    assert await stage.answer("/simulation/pause", data=False) == (True, "the time of the simulation passes")
    assert [(each.paused, each.ticks) for each in stage.arm.pauses] == [(True, 0), (True, 3), (True, 3), (False, 0)]


async def test_an_arm_whose_process_is_started_again_is_paused_again_until_time_is_to_pass(stage: Stage) -> None:
    await stage.answer("/simulation/pause", 0, data=True)
    stage.report(mode=Mode.DISCONNECTED)
    assert stage.arm.pauses == [PauseSimulation(paused=True)]
    stage.report()
    stage.report(ticks=0)
    assert stage.arm.pauses == 2 * [PauseSimulation(paused=True)]
    await stage.answer("/simulation/pause", None, data=False)
    stage.report()
    assert stage.arm.pauses[2:] == [PauseSimulation(paused=False)]


async def test_services_need_the_role_operate_and_steps_a_pause_and_come_one_after_the_other(stage: Stage) -> None:
    rules = stage.graph.services.rules
    assert {name for name, rule in rules.items() if rule == Rule(Role.OPERATE)} == {
        f"/simulation/{name}" for name in ("set_body", "set_pose", "reset", "pause", "step")
    }
    passes = "the time of the simulation passes: call /simulation/pause with true first"
    assert await stage.answer("/simulation/step", steps=1) == (False, passes)
    stage.report(ticks=0)
    for steps in (0, MAX_STEPS + 1):
        assert await stage.answer("/simulation/step", steps=steps) == (False, f"steps must be 1 to 1000, not {steps}")
    stage.graph.services.call(Node("first"), "/simulation/step", {"steps": 2}, lambda _answer: None)
    await asyncio.sleep(0)
    assert await stage.answer("/simulation/step", steps=1) == (False, "other steps are in progress")


async def test_an_arm_that_does_not_answer_ends_the_wait_and_the_pause(stage: Stage, monkeypatch: Any) -> None:
    monkeypatch.setattr("server.features.physics.ANSWER_TIMEOUT_S", 0.0)
    assert await stage.answer("/simulation/pause", data=True) == (False, "the arm process did not answer within 0 s")
    assert [each.paused for each in stage.arm.pauses] == [True, False]


FAR = "pose has a position that is not finite or beyond 100 m: (1000.0, 0.0, 0.0)"
FIXED = "'wall' stays where it is: move it in the planning scene, or make it movable first"
MASS = "mass must be 0 to 100 kg, 0 for a mass by its volume, not"


async def test_what_no_body_can_have_is_refused(stage: Stage) -> None:
    stage.apply({"id": "floor", "planes": [{"coef": [0.0, 0.0, 1.0, 0.05]}], "plane_poses": [pose()]})
    assert stage.arm.bodies["floor"].shapes[0].position_m == (0.0, 0.0, -0.05)
    stage.call("/simulation/set_body", id="cube", movable=True)
    sent = len(stage.arm.sent)
    for service, asked, said in (
        ("set_pose", {"id": "ball", "pose": pose()}, "the physics has no object 'ball'"),
        ("set_pose", {"id": "wall", "pose": pose()}, FIXED),
        ("set_pose", {"id": "cube", "pose": pose(math.nan)}, "pose.position.x must be a finite number, not nan"),
        ("set_pose", {"id": "cube", "pose": pose(1000.0)}, FAR),
        ("set_body", {"id": "ball"}, "there is no object 'ball' in the planning scene"),
        ("set_body", {"id": "wall", "mass": -1.0}, f"{MASS} -1"),
        ("set_body", {"id": "wall", "mass": math.nan}, f"{MASS} nan"),
        ("set_body", {"id": "wall", "friction": 11.0}, "friction must be 0 to 10, 0 for 1, not 11"),
        ("set_body", {"id": "floor"}, "'floor' has a plane, and cannot be movable"),
    ):
        movable = {"movable": True} if service == "set_body" else {}
        assert stage.call(f"/simulation/{service}", **asked, **movable) == (False, said)
        assert len(stage.arm.sent) == sent, said


async def test_more_objects_than_physics_has_are_left_out(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        stage.apply(*(box(f"box {at}") for at in range(MAX_BODIES)))
    assert caplog.messages == ["physics has 100 objects at most: the last 2 of the scene are left out"]
    assert len(stage.arm.bodies) == MAX_BODIES
    said = stage.call("/simulation/set_body", id="box 99", movable=True)
    assert said == (False, "physics has 100 objects at most, and 'box 99' is left out")


async def test_a_reset_brings_back_the_world_that_was_loaded() -> None:
    stage = Stage(world="cubes", world_seed=4)
    await stage.physics.start()
    assert {name: body.movable for name, body in stage.arm.bodies.items()} == {
        f"cube_{color}": True for color in ("red", "green", "blue", "yellow")
    }
    before, poses = stage.arm.bodies, {name: each.pose for name, each in stage.scene.contents.objects.items()}
    assert stage.position("cube_red") != (0.2, -0.1, 0.016)
    stage.apply(box("wall", at=pose(0.4, 0.0, 0.1)), {"id": "cube_blue", "operation": 1})
    stage.call("/simulation/set_body", id="cube_red")
    stage.attach("cube_green")
    assert stage.call("/simulation/reset") == (True, "put back: cube_red, cube_green, cube_blue, cube_yellow")
    assert stage.arm.bodies == before
    assert {name: each.pose for name, each in stage.scene.contents.objects.items()} == poses
    assert stage.arm.sent[-1].placed.keys() == before.keys()
    assert stage.scene.contents.attached == {}


LEFT, PLANE = box("left", at=pose(0.3, 0.3, 0.05)), {"coef": [0.0, 0.0, 1.0, 0.05]}


async def test_a_world_that_cannot_be_is_refused(tmp_path: Path) -> None:
    for objects, sentence in (
        ([LEFT, box("right", at=pose(0.3, 0.32, 0.05))], "'left' overlaps 'right' by 30 mm, more than 2 mm"),
        ([box("left", at=pose(math.nan))], "the object 'left': .*pose.position.x must be a finite number"),
        ([box(str(at)) for at in range(MAX_BODIES + 1)], "it has 101 objects, more than 100"),
        ([{"id": "left", "planes": [PLANE], "plane_poses": [pose()]}], "'left' has a plane, and cannot be movable"),
    ):
        path = tmp_path / "world.json"
        bodies = [{"id": each["id"], "movable": True} for each in objects]
        path.write_text(json.dumps({"world": {"collision_objects": objects}, "bodies": bodies}))
        with pytest.raises(ConfigurationError, match=rf"simulation\.world: .*{sentence}"):
            Stage(world=str(path))


def two_arms(roll_rad: float = 0.0) -> Stage:
    """Two arms at their places; the right one is turned by 90 degrees."""
    placed = {}
    for name, y, yaw_rad, link in (("left", 0.2, 0.0, FINGERS[0]), ("right", -0.2, 0.5 * math.pi, FINGERS[1])):
        settings = NamedArmSettings(base_xyz_m=(0.0, y, 0.0), base_rpy_rad=(roll_rad, 0.0, yaw_rad))
        placed[name] = settings, SimpleNamespace(links=[link], gripper=None)
    return Stage(placed)


@pytest.fixture
async def two() -> Stage:
    made = two_arms()
    made.apply(box("cube", at=pose(0.0, 0.1, 0.025)))
    return made


async def test_an_object_moves_in_the_world_of_the_nearest_arm_alone_and_follows_in_the_other(two: Stage) -> None:
    assert two.seen() == [(0.0, -0.1, 0.025), (0.3, 0.0, 0.025)]
    two.call("/simulation/set_body", id="cube", movable=True)
    assert two.movers() == {"left": True, "right": False}
    sent = len(two.arms["left"].sent)
    two.report(BodyState("cube", (0.0, -0.1, 0.08), LEVEL, held=False), arm="left", gripper_rad=None)
    two.report(BodyState("cube", (0.0, 0.0, 0.5), LEVEL, held=False), arm="right")
    assert two.position("cube") == pytest.approx((0.0, 0.1, 0.08))
    assert two.seen()[1] == (0.3, 0.0, 0.08)
    assert len(two.arms["left"].sent) == sent, "the arm that moves it is told where it is"


async def test_an_object_moves_in_the_world_of_the_arm_that_it_is_attached_to_from_where_it_is(two: Stage) -> None:
    two.call("/simulation/set_body", id="cube", movable=True)
    two.report(BodyState("cube", (0.0, -0.1, 0.08), LEVEL, held=False), arm="left")
    two.attach("cube", link=FINGERS[1])
    assert two.movers() == {"left": False, "right": True}
    assert two.arms["right"].sent[-1].placed["cube"][0] == pytest.approx((0.3, 0.0, 0.08))
    assert two.seen()[0] == (0.0, -0.1, 0.08)


async def test_a_client_names_the_arm_that_moves_an_object_and_time_stands_still_for_both(two: Stage) -> None:
    assert two.call("/right/simulation/set_body", id="cube", movable=True) == (True, "cube can be moved")
    assert two.movers() == {"left": False, "right": True}
    assert (await two.answer("/simulation/pause", 0, data=True))[0]
    assert all(arm.pauses == [PauseSimulation(paused=True)] for arm in two.arms.values())


async def test_an_arm_that_leans_has_no_physics() -> None:
    with pytest.raises(ConfigurationError, match=r"arms\.left\.base_rpy_rad: physics needs an upright arm.*not 0\.1"):
        two_arms(roll_rad=0.1)


MESSAGE_TYPES = Graph(REGISTRY).message_types
CUBE = {"id": "cube", "primitives": [{"type": 1, "dimensions": [0.03, 0.03, 0.03]}]}


@pytest.mark.parametrize(("name", "movable"), [("cubes", 4), ("table", 1), ("peg", 1)])
def test_a_built_in_world_has_objects_and_movable_ones(name: str, movable: int) -> None:
    scene, bodies = read_world(name, MESSAGE_TYPES)
    assert len(scene["world"]["collision_objects"]) >= len(bodies)
    assert [body["movable"] for body in bodies] == [True] * movable


def test_a_saved_scene_is_a_world_of_fixed_objects(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    path.write_text(json.dumps({"world": {"collision_objects": [CUBE]}}))
    scene, bodies = read_world(str(path), MESSAGE_TYPES)
    assert ([each["id"] for each in scene["world"]["collision_objects"]], list(bodies)) == (["cube"], [])


def test_what_is_wrong_with_a_file_or_a_file_that_is_none_has_a_sentence(tmp_path: Path) -> None:
    for content, sentence in (
        ({"bodies": 3}, "wanted armbridge_msgs/srv/SetBody_Request, got 3"),
        ({"bodies": [{"id": "cube", "weight": 1.0}]}, "field weight: wanted a field of .*SetBody_Request"),
        ({"bodies": [{"id": "ball"}]}, r"bodies\[0\]\.id: there is no object 'ball' in the scene"),
        ({"bodies": [{"id": "cube", "mass": -1.0}]}, r"bodies\[0\]\.mass must be 0 to 100 kg, .* not -1"),
        ({"bodies": [{"id": "cube", "friction": float("nan")}]}, r"bodies\[0\]\.friction must be 0 to 10, .* nan"),
        ([], "message: wanted moveit_msgs/msg/PlanningScene, got a list of 0"),
        ({"objects": []}, "field objects: wanted a field of moveit_msgs/msg/PlanningScene"),
    ):
        path = tmp_path / "wrong.json"
        whole = {"world": {"collision_objects": [CUBE]}, **content} if isinstance(content, dict) else content
        path.write_text(json.dumps(whole))
        with pytest.raises((ValueError, MessageError), match=sentence):
            read_world(str(path), MESSAGE_TYPES)
    with pytest.raises(ValueError, match="there is no such file; the built-in worlds are cubes, peg, table"):
        read_world("cube", MESSAGE_TYPES)
    path = tmp_path / "broken.json"
    path.write_text("{")
    with pytest.raises(ValueError, match="it is no JSON: Expecting property name"):
        read_world(str(path), MESSAGE_TYPES)


def shape_of(**fields: Any) -> BodyShape:
    contents = scene_state(collision_object(id="it", **fields)).contents
    (shape,) = body_of(contents.objects["it"]).shapes
    return shape


def test_round_shapes_have_their_size_and_a_plane_its_normal_along_z() -> None:
    for kind, expected in ((2, ("sphere", (0.06,))), (3, ("cylinder", (0.02, 0.03))), (4, ("hull", ()))):
        shape = shape_of(primitives=[{"type": kind, "dimensions": [0.06, 0.02]}], primitive_poses=[pose()])
        assert (shape.kind, shape.size_m) == expected
        if kind == 4:
            assert np.ptp(np.array(shape.vertices_m), axis=0) == pytest.approx([0.04, 0.04, 0.06]), kind
    for normal, place in (((0.0, 0.0, 1.0), (0.0, 0.0, -0.05)), ((0.0, 0.0, -1.0), (0.0, 0.0, 0.05))):
        shape = shape_of(planes=[{"coef": [*normal, 0.05]}], plane_poses=[pose()])
        assert shape.position_m == pytest.approx(place)
        x, y, _, _ = shape.orientation
        assert 1.0 - 2.0 * (x * x + y * y) == pytest.approx(normal[2])


def test_a_mesh_of_many_corners_has_its_outermost_ones() -> None:
    vertices = np.random.default_rng(3).normal(size=(3000, 3))
    vertices *= 0.05 / np.linalg.norm(vertices, axis=1)[:, np.newaxis]
    mesh = {
        "vertices": [dict(zip("xyz", each, strict=True)) for each in vertices.tolist()],
        "triangles": [{"vertex_indices": [at, at + 1, at + 2]} for at in range(0, 2998, 3)],
    }
    corners = np.array(shape_of(meshes=[mesh], mesh_poses=[pose()]).vertices_m)
    assert 100 < len(corners) <= MAX_HULL_CORNERS
    assert np.ptp(corners, axis=0) == pytest.approx([0.1] * 3, rel=0.02)
