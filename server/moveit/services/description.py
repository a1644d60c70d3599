"""Description of the robot for clients: latched topics, parameters, the files that the URDF names, and transforms.

MoveIt's clients read the URDF and SRDF from latched topics (ROS 2) or parameters (ROS 1), and fetch meshes by
``package://`` URLs from file_server's service ``/file_server/get_file`` (compas_robots, ros-sharp). Those that fetch
by HTTP are answered by :mod:`server.gateway.http`. Viewers in a browser get transforms between chosen frames as
tf2_web_republisher sends them: ros3djs and roslib's TFClients ask by an action, whose feedback has the transforms, or
by a service, which names a topic. A transform is sent again once it has moved beyond the viewer's thresholds.
``/armbridge/robot`` has the joint groups as JSON, for a page that reads neither URDF nor SRDF for them.
"""

import base64
import functools
import itertools
import json
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any

from planners.scene import Pose
from protocol.messages import ListLimits, Stamp
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.joined import chain_lengths_m
from robot.description.model import RobotModel
from robot.description.srdf import Group
from robot.logs import LogLimiter
from robot.messages import ArmState
from server.disk import Disk
from server.errors import RefusedError, ServiceError
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import LOOKING
from server.graph.topics import Graph
from server.moveit.actions.gripper import GRIPPER_ACTION
from server.moveit.messages import Message, pose_of, write_transform
from server.moveit.parameters import MoveItParameters
from server.moveit.requests.constraints import planning_group, tip_link
from server.moveit.scene.frames import Frames, seen_from
from server.robot_files import RobotFiles, with_package_urls

log = logging.getLogger("armbridge.description")

URDF_TOPIC = "/robot_description"
SRDF_TOPIC = "/robot_description_semantic"
# Nodes that have these parameters in ROS 2.
NODES = ("/robot_state_publisher", "/move_group")

FILE_SERVICE = "/file_server/get_file"

TRANSFORMS_TOPIC = "/tf"
STATIC_TRANSFORMS_TOPIC = "/tf_static"

# A state that is due a little early still counts.
EARLY_S = 0.005


def offer_description(graph: Graph, robot: RobotModel, keep_parameter: Callable[[str, str], None]) -> None:
    node, files, disk = graph.node("robot description"), RobotFiles(robot), Disk()
    texts = {URDF_TOPIC: with_package_urls(robot), SRDF_TOPIC: robot.srdf}
    for topic, text in texts.items():
        node.advertise(topic, "std_msgs/String", latch=True)
        node.publish(topic, {"data": text})
        name = topic.removeprefix("/")
        # ROS 1 clients ask for the name with its slash or without, clients of ROS 2 for a parameter of a node.
        for parameter in (topic, name, *(f"{each}:{name}" for each in NODES)):
            keep_parameter(parameter, json.dumps(text))

    async def get_file(request: dict[str, Any]) -> dict[str, Any]:
        name = request["name"]
        octets = await disk.serve(name, "name: it cannot be read", lambda: files.find(name).read_bytes())
        return {"value": base64.b64encode(octets).decode("ascii")}

    node.offer(FILE_SERVICE, "file_server/GetBinaryFile", get_file, rule=LOOKING)


class TransformsTopics:
    """Transforms of the arm: transforms of movable joints with the joint states, the others once."""

    def __init__(self, graph: Graph, robot: RobotModel) -> None:
        self._placements = ForwardPlacements(robot)
        joints = robot.joints.values()
        self._moving = [joint.child for joint in joints if joint.moves]
        self._fixed = [joint.child for joint in joints if not joint.moves]
        self._node = graph.node("robot state publisher")
        self._node.advertise(TRANSFORMS_TOPIC, "tf2_msgs/TFMessage")
        self._node.advertise(STATIC_TRANSFORMS_TOPIC, "tf2_msgs/TFMessage", latch=True)
        fixed = self._message(self._fixed, {}, graph.message_types.wall_clock())
        self._node.publish(STATIC_TRANSFORMS_TOPIC, fixed)

    def take_state(self, state: ArmState) -> None:
        """Publish a state of the arm, if there are subscribers."""
        if state.position_rad is None or not self._node.subscribers(TRANSFORMS_TOPIC):
            return
        positions_rad = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
        self._node.publish(TRANSFORMS_TOPIC, self._message(self._moving, positions_rad, state.stamp_s))

    def _message(self, links: list[str], positions_rad: Mapping[str, float], stamp_s: float) -> dict[str, Any]:
        stamp = Stamp.from_seconds(stamp_s).as_message()
        transforms = []
        for link in links:
            parent, transform_link_to_parent = self._placements.joint_transform(link, positions_rad)
            transforms.append(
                {
                    "header": {"stamp": stamp, "frame_id": parent},
                    "child_frame_id": link,
                    "transform": write_transform(pose_of(transform_link_to_parent)),
                }
            )
        return {"transforms": transforms}


ACTION, SERVICE = "/tf2_web_republisher", "/republish_tfs"
ACTION_TYPE, SERVICE_TYPE = "tf2_web_republisher/action/TFSubscription", "tf2_web_republisher/srv/RepublishTFs"
ARRAY_TYPE = "tf2_web_republisher/msg/TFArray"

# A page has one subscription and renews it with each frame; a robot has a few dozen frames.
MAX_SUBSCRIPTIONS = 100
MAX_FRAMES = 200
REQUESTS = f"{ACTION_TYPE}_Goal", f"{SERVICE_TYPE}_Request"
LIMITS = ListLimits({f"{name}.source_frames": MAX_FRAMES for name in REQUESTS})

# A page may stay open for weeks, and its goal ends with its connection.
MAX_GOAL_S = 30 * 24 * 3600.0

# roslib's default, and more than the eye follows.
DEFAULT_RATE_HZ, MAX_RATE_HZ = 10.0, 30.0

# A topic without subscribers ends after the time that its request names, at most this.
MAX_TIMEOUT_S = 60.0


class _Subscription:
    def __init__(self, request: Message, send: Callable[[list[dict[str, Any]]], object]) -> None:
        self.send = send
        self.due_s = -math.inf
        rate_hz = request["rate"]
        self.period_s = 1.0 / min(rate_hz if rate_hz > 0.0 else DEFAULT_RATE_HZ, MAX_RATE_HZ)
        self.target = request["target_frame"].removeprefix("/")
        self.sources = dict.fromkeys(name.removeprefix("/") for name in request["source_frames"])
        self._distance_m = request["trans_thres"]
        # Degrees, though tf2_web_republisher compares radians: roslib's default of 2 would hide nearly every rotation.
        self._angle_rad = math.radians(request["angular_thres"])
        self.sent: dict[str, Pose] = {}
        # Of the topic that the service has made for it: its subscribers, and the time of the last look that found any.
        self.subscribers = 0
        self.timeout_s = self.watched_s = 0.0

    def changed(self, source: str, pose: Pose) -> bool:
        """Return True for a transform that is due, and note it as sent."""
        sent = self.sent.get(source)
        if sent is not None:
            cosine = abs(sum(map(math.prod, zip(sent.orientation, pose.orientation, strict=True))))
            turned_rad = 2.0 * math.acos(min(cosine, 1.0))
            if math.dist(sent.position_m, pose.position_m) <= self._distance_m and turned_rad <= self._angle_rad:
                return False
        self.sent[source] = pose
        return True


class TransformRepublisher:
    """The action and the service."""

    def __init__(self, graph: Graph, frames: Frames) -> None:
        self._frames = frames
        self._clock = graph.clock
        self._node = graph.node("tf2 web republisher")
        self._goals: dict[ActionGoal, _Subscription] = {}
        self._topics: dict[str, _Subscription] = {}
        self._numbers = itertools.count(1)
        self._warnings = LogLimiter()
        self._node.offer_action(ACTION, ACTION_TYPE, self._start, LIMITS, rule=LOOKING, max_goal_s=MAX_GOAL_S)
        self._node.offer(SERVICE, SERVICE_TYPE, self._republish, limits=LIMITS, rule=LOOKING)

    def take_state(self, state: ArmState) -> None:
        """Send the transforms that are due and have changed."""
        if state.position_rad is None or not (self._goals or self._topics):
            return
        now_s = self._clock()
        self._end_left(now_s)
        positions_rad = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
        relative = functools.cache(functools.partial(self._relative, positions_rad))
        stamp = self._node.message_types.now().as_message()
        watched = [topic for topic in self._topics.values() if topic.subscribers]
        for subscription in (*self._goals.values(), *watched):
            if now_s < subscription.due_s:
                continue
            subscription.due_s = now_s + subscription.period_s - EARLY_S
            header = {"stamp": stamp, "frame_id": subscription.target}
            transforms = [
                {"header": header, "child_frame_id": source, "transform": write_transform(pose)}
                for source in subscription.sources
                if (pose := relative(subscription.target, source)) is not None and subscription.changed(source, pose)
            ]
            if transforms:
                subscription.send(transforms)

    def _relative(self, positions_rad: Mapping[str, float], target: str, source: str) -> Pose | None:
        """Return the pose of a frame in another one; None where one of them is unknown."""
        try:
            return seen_from(*(self._frames.resolve(frame, positions_rad) for frame in (target, source)))
        except RefusedError as error:
            # As a name that is misspelt: its client would wait for it in silence.
            self._warnings.write(log, logging.WARNING, f"{ACTION}: {error}", (target, source))
            return None

    def _start(self, goal: ActionGoal) -> None:
        if not self._has_room():
            goal.fail(f"there are {MAX_SUBSCRIPTIONS} subscriptions already, the limit")
            return
        self._goals[goal] = _Subscription(goal.request, lambda transforms: goal.feedback({"transforms": transforms}))
        goal.when_ended(lambda _result: self._goals.pop(goal))
        goal.when_canceled(lambda: goal.finish(GoalStatus.CANCELED, {}))

    def _republish(self, request: dict[str, Any]) -> dict[str, Any]:
        if not self._has_room():
            raise ServiceError(f"there are {MAX_SUBSCRIPTIONS} subscriptions already, the limit")
        topic = f"{ACTION}/tf_repub_{next(self._numbers)}"
        self._node.advertise(topic, ARRAY_TYPE)
        subscription = _Subscription(request, lambda transforms: self._node.publish(topic, {"transforms": transforms}))
        timeout = request["timeout"]
        subscription.timeout_s = min(timeout["sec"] + 1e-9 * timeout["nanosec"], MAX_TIMEOUT_S)
        subscription.watched_s, self._topics[topic] = self._clock(), subscription
        return {"topic_name": topic}

    def _has_room(self) -> bool:
        self._end_left(self._clock())
        return len(self._goals) + len(self._topics) < MAX_SUBSCRIPTIONS

    def _end_left(self, now_s: float) -> None:
        for goal in [goal for goal in self._goals if goal.sender_left]:
            goal.cancel()
        for name, topic in list(self._topics.items()):
            before, topic.subscribers = topic.subscribers, len(self._node.subscribers(name))
            if topic.subscribers:
                topic.watched_s = now_s
            elif now_s - topic.watched_s > topic.timeout_s:
                self._node.unadvertise(name)
                del self._topics[name]
            if topic.subscribers > before:
                topic.sent.clear()


ROBOT_TOPIC = "/armbridge/robot"


def publish_groups(
    graph: Graph, robot: RobotModel, arms: Mapping[str, RobotModel], parameters: MoveItParameters
) -> None:
    """Publish the groups, latched, of one arm with an empty name or of several arms by their names."""
    node = graph.node("robot groups")
    node.advertise(ROBOT_TOPIC, "std_msgs/String", latch=True)
    node.publish(ROBOT_TOPIC, {"data": json.dumps(groups_document(robot, arms, parameters))})


def groups_document(robot: RobotModel, arms: Mapping[str, RobotModel], parameters: MoveItParameters) -> dict[str, Any]:
    """Return the joints with their types, the groups without grippers, and a bound of the tips' reach [m]."""
    grippers = {joint for arm in arms.values() if arm.gripper for joint in arm.gripper.joints}
    groups = [group for group in robot.groups.values() if not grippers.issuperset(group.joints)]
    return {
        "joints": {joint.name: joint.type for joint in robot.movable_joints},
        "default_group": planning_group(robot, "", parameters).name,
        "groups": [_group(group, robot, arms, tip_link(robot, group, parameters)) for group in groups],
        "reach_m": max(chain_lengths_m(robot).values()),
    }


def _group(group: Group, robot: RobotModel, arms: Mapping[str, RobotModel], tip: str) -> dict[str, Any]:
    # A group with joints of several arms is driven by no arm's servo node, and has no gripper of its own.
    name = next((name for name, arm in arms.items() if arm.joints.keys() >= set(group.joints)), None)
    namespace = None if name is None else f"/{name}" if name else ""
    gripper = None if name is None else arms[name].gripper
    return {
        "name": group.name,
        "joints": group.joints,
        "tip": tip or None,
        "touch_links": _carried_by(tip, robot) if tip else [],
        "namespace": namespace,
        "gripper": gripper
        and {
            "joints": gripper.joints,
            "open": gripper.open,
            "closed": gripper.closed,
            "action": f"{namespace}{GRIPPER_ACTION}",
        },
    }


def _carried_by(tip: str, robot: RobotModel) -> list[str]:
    """Return the links that an object at the tip may touch: the tip's rigid body, and all that it carries."""
    above = {joint.child: joint for joint in robot.joints.values()}
    body = tip
    while body in above and not above[body].moves:
        body = above[body].parent

    def is_carried(link: str) -> bool:
        while link != body and link in above:
            link = above[link].parent
        return link == body

    return [link for link in robot.links if is_carried(link)]
