import base64
import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners.scene import Pose
from robot.messages import ArmState, Mode
from server import robot_files
from server.errors import FileTooLargeError, ServiceError
from server.graph.topics import Graph
from server.moveit.messages import matrix_of, pose_of
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState
from server.moveit.services import description
from server.robot_files import RobotFiles, with_package_urls
from tests.helpers.fake_arm import JOINTS
from tests.helpers.gateway import InProcess
from tests.helpers.graph import called, listen
from tests.helpers.moveit import FORWARD, REGISTRY, ROBOT

PACKAGE = "so101_description"


async def test_the_description_is_latched_and_a_parameter_and_its_meshes_are_served_by_name(files: Path) -> None:
    graph = Graph(REGISTRY)
    parameters: dict[str, str] = {}
    description.offer_description(graph, replace(ROBOT, mesh_directory=files), parameters.__setitem__)
    for topic in (description.URDF_TOPIC, description.SRDF_TOPIC):
        (kept,) = listen(graph, topic)
        assert ET.fromstring(kept["data"]).tag == "robot"
        name = topic.removeprefix("/")
        for parameter in (topic, name, f"/robot_state_publisher:{name}", f"/move_group:{name}"):
            assert json.loads(parameters[parameter]) == kept["data"]
    response = await called(graph, description.FILE_SERVICE, name=f"package://{PACKAGE}/assets/base.stl")
    assert base64.b64decode(response.values["value"]) == b"solid"


def urdf(*meshes: str) -> str:
    visuals = "".join(f'<visual><mesh filename="{mesh}"/></visual>' for mesh in meshes)
    return f'<robot name="so101"><link name="base">{visuals}</link></robot>'


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "secret.stl").write_text("key")
    directory = tmp_path / "robot"
    (directory / "assets").mkdir(parents=True)
    (directory / "assets" / "base.stl").write_bytes(b"solid")
    (directory / "assets" / "out.stl").symlink_to(tmp_path / "secret.stl")
    (directory / ".cache").mkdir()
    (directory / ".cache" / "a.png").write_bytes(b"PNG")
    (directory / "id_rsa").write_text("key")
    (directory / "arm.urdf").write_text("<robot/>")
    return directory


def test_meshes_named_by_a_path_get_package_urls_and_others_keep_theirs() -> None:
    served = with_package_urls(
        replace(ROBOT, urdf=urdf("assets/base.stl", "./assets/arm.stl", "package://other/a.stl"))
    )
    names = [str(mesh.get("filename")).replace(PACKAGE, "own") for mesh in ET.fromstring(served).iter("mesh")]
    assert names == ["package://own/assets/base.stl", "package://own/assets/arm.stl", "package://other/a.stl"]
    assert with_package_urls(ROBOT) == ROBOT.urdf


def files_in(directory: Path | None) -> RobotFiles:
    return RobotFiles(replace(ROBOT, mesh_directory=directory))


NOT_BELOW = ["../secret.stl", f"package://{PACKAGE}/../secret.stl", "assets/out.stl", ".cache/a.png", "/etc/hosts"]
NO_FILES = ["assets", "", "no", "\0", "a" * 999]
NO_MESHES = ["id_rsa", f"package://{PACKAGE}/id_rsa", "arm.urdf"]


@pytest.mark.parametrize(
    ("name", "words"),
    [(name, "name: ") for name in NOT_BELOW + NO_FILES] + [(name, "neither mesh nor texture") for name in NO_MESHES],
)
def test_only_meshes_and_textures_below_the_description_are_served(files: Path, name: str, words: str) -> None:
    with pytest.raises(ServiceError, match=words):
        files_in(files).find(name)


def test_files_of_packages_are_found_and_those_too_large_refused(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("assets/base.stl", f"package://{PACKAGE}/assets/base.stl", "package://robot/assets/base.stl"):
        assert files_in(files).find(name) == files / "assets" / "base.stl", name
    inner = files / PACKAGE / "base.stl"
    inner.parent.mkdir()
    inner.write_bytes(b"solid")
    assert files_in(files).find(f"package://{PACKAGE}/base.stl") == inner
    assert files_in(files).find("package://assets/base.stl") == files / "assets" / "base.stl"
    monkeypatch.setattr(robot_files, "MAX_FILE_BYTES", 4)
    with pytest.raises(FileTooLargeError, match="5 bytes, the limit is 4"):
        files_in(files).find("assets/base.stl")
    with pytest.raises(ServiceError, match="names no files"):
        files_in(None).find("assets/base.stl")


def test_files_beside_the_meshes_of_a_package_are_served_and_nothing_else_of_it(tmp_path: Path) -> None:
    (tmp_path / "arm_meshes" / "meshes" / "visual").mkdir(parents=True)
    (tmp_path / "arm_meshes" / "secret.stl").write_text("key")
    for name in ("base.dae", "skin.png", "notes.txt"):
        (tmp_path / "arm_meshes" / "meshes" / "visual" / name).write_text(name)
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    meshes = "package://arm_meshes/meshes/visual/base.dae", "package://gone/a.stl"
    packaged = RobotFiles(replace(ROBOT, urdf=urdf(*meshes), mesh_directory=folder, package_directories=(tmp_path,)))
    visual = "package://arm_meshes/meshes/visual"
    for name in ("base.dae", "skin.png"):
        assert packaged.find(f"{visual}/{name}").read_bytes() == name.encode()
    elsewhere = "package://arm_meshes/secret.stl", f"{visual}/../../secret.stl"
    for name in (*elsewhere, f"{visual}/notes.txt", "package://gone/a.stl"):
        with pytest.raises(ServiceError, match="name: "):
            packaged.find(name)


# As roslib's clients ask by default.
REQUEST = {
    "source_frames": ["gripper_link", "/shoulder_link", "nowhere"],
    "target_frame": ROBOT.root_link,
    "angular_thres": 2.0,
    "trans_thres": 0.01,
    "rate": 10.0,
}


class World(InProcess):
    """Clients, and an arm of which one joint moves."""

    def __init__(self) -> None:
        super().__init__()
        self.republisher = description.TransformRepublisher(self.graph, Frames(SceneState(ROBOT)))

    def move(self, elbow_rad: float, seconds: float = 1.0) -> None:
        """Have the arm be at an angle after some time."""
        self.clock.advance(seconds)
        positions_rad = np.array([elbow_rad if name == "elbow_flex" else 0.0 for name in JOINTS])
        self.republisher.take_state(ArmState(1.0, Mode.HOLDING, JOINTS, position_rad=positions_rad))

    def send_goal(self, client: str = "c", package: str = "tf2_web_republisher_msgs", **thresholds: float) -> None:
        fields = {"action": description.ACTION, "action_type": f"{package}/TFSubscription", "feedback": True}
        self.say(client, op="send_action_goal", id="g", args={**REQUEST, **thresholds}, **fields)

    def moved(self, client: str = "c") -> list[str]:
        """The frames whose transforms a client has heard since the last time."""
        messages = [each.get("values") or each["msg"] for each in self.heard(client)]
        return [transform["child_frame_id"] for message in messages for transform in message["transforms"]]


@pytest.fixture
def world() -> World:
    return World()


@pytest.mark.parametrize("package", ["tf2_web_republisher_interfaces", "tf2_web_republisher_msgs"])
def test_an_actions_feedback_has_the_transforms_of_the_known_frames(world: World, package: str) -> None:
    world.send_goal(package=package)
    world.move(0.4)
    (feedback,) = world.heard("c")
    gripper, shoulder = feedback["values"]["transforms"]
    assert (gripper["header"]["frame_id"], gripper["child_frame_id"]) == (ROBOT.root_link, "gripper_link")
    assert shoulder["child_frame_id"] == "shoulder_link"
    positions_rad = {name: 0.4 if name == "elbow_flex" else 0.0 for name in JOINTS}
    pose = pose_of(FORWARD.transforms(positions_rad)["gripper_link"])
    assert list(gripper["transform"]["translation"].values()) == pytest.approx(pose.position_m)
    assert list(gripper["transform"]["rotation"].values()) == pytest.approx(pose.orientation)


@pytest.mark.parametrize(
    ("thresholds", "small_rad", "large_rad"),
    [({}, 0.001, 0.5), ({"trans_thres": 10.0}, np.radians(1.0), np.radians(3.0))],
)
def test_only_transforms_beyond_the_thresholds_are_sent_again_at_the_rate_and_an_unknown_frame_is_logged_once(
    world: World, thresholds: dict[str, float], small_rad: float, large_rad: float, caplog: pytest.LogCaptureFixture
) -> None:
    world.send_goal(**thresholds)
    world.move(0.0)
    assert world.moved() == ["gripper_link", "shoulder_link"]
    for elbow_rad, seconds, moved in ((small_rad, 1.0, []), (large_rad, 0.02, []), (large_rad, 0.1, ["gripper_link"])):
        world.move(elbow_rad, seconds)
        assert world.moved() == moved
    assert caplog.text.count("tf2_web_republisher") == 1
    assert "'nowhere'" in caplog.text


def test_goals_end_when_left_and_subscriptions_are_bounded(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.send_goal("a")
    world.send_goal("b")
    world.say("a", op="cancel_action_goal", id="g", action=description.ACTION)
    (result,) = world.heard("a")
    assert (result["op"], result["status"]) == ("action_result", 5)
    world.client("b").leave()
    world.move(0.4)
    assert not world.republisher._goals
    monkeypatch.setattr(description, "MAX_SUBSCRIPTIONS", 1)
    world.send_goal("a")
    world.say("c", op="call_service", service=description.SERVICE, args=REQUEST)
    world.send_goal("c")
    for answer in world.heard("c"):
        assert (answer["result"], answer["values"]) == (False, "there are 1 subscriptions already, the limit")


def test_a_topic_has_all_transforms_for_a_new_subscriber_and_ends_without_one(world: World) -> None:
    world.say("c", op="call_service", service=description.SERVICE, args={**REQUEST, "timeout": {"sec": 2}})
    topic = world.heard("c")[0]["values"]["topic_name"]
    for _ in range(2):
        world.say("c", op="subscribe", topic=topic)
        for _ in range(3):
            world.move(0.4)
        assert world.moved() == ["gripper_link", "shoulder_link"]
        world.say("c", op="unsubscribe", topic=topic)
        world.move(0.4)
    world.move(0.4)
    assert topic in world.graph.topic_names.types()
    world.move(0.4)
    assert topic not in world.graph.topic_names.types()


class Screen:
    """The topics, and what somebody hears who subscribes after the start."""

    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.topics = description.TransformsTopics(self.graph, ROBOT)
        self.heard = listen(self.graph, description.TRANSFORMS_TOPIC)
        (self.static,) = listen(self.graph, description.STATIC_TRANSFORMS_TOPIC)

    def show(self, position_rad: float) -> None:
        positions = np.full(len(JOINTS), position_rad)
        self.topics.take_state(ArmState(1.0, Mode.HOLDING, JOINTS, position_rad=positions))


@pytest.fixture
def screen() -> Screen:
    return Screen()


def test_both_transform_topics_together_place_every_link_as_forward_kinematics_does(screen: Screen) -> None:
    screen.show(0.4)
    placed = {ROBOT.root_link: np.eye(4)}
    transforms = {
        each["child_frame_id"]: each for message in (screen.static, *screen.heard) for each in message["transforms"]
    }
    for link in ROBOT.links[1:]:
        parent, own = transforms[link]["header"]["frame_id"], transforms[link]["transform"]
        translation, rotation = own["translation"], own["rotation"]
        pose = Pose(tuple(translation[axis] for axis in "xyz"), tuple(rotation[axis] for axis in "xyzw"))
        placed[link] = placed[parent] @ matrix_of(pose)
    for link, transform in FORWARD.transforms(dict.fromkeys(JOINTS, 0.4)).items():
        assert placed[link] == pytest.approx(transform, abs=1e-9)


def test_a_disconnected_arm_has_no_transforms(screen: Screen) -> None:
    screen.topics.take_state(ArmState(1.0, Mode.DISCONNECTED, JOINTS))
    assert screen.heard == []
