"""Samples of a recording: positions of joints, stamps of images and marks of episodes, on one axis of time."""

import contextlib
import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from protocol.registry import Registry
from server.arm.interface import CALIBRATED_RANGE, LIMITS_TOPIC
from server.arm.interface import STATE_TOPIC as ARM_STATE_TOPIC
from server.chunks.action_chunks import STATE as POLICY_TOPIC
from server.chunks.action_chunks import PolicyPhase
from server.datasets.episodes import EPISODE_TOPIC, IMAGES, RAW_IMAGE
from server.errors import RecordingError
from server.recording.files import RecordedMessage
from server.recording.reading import messages

Times: TypeAlias = NDArray[np.float64]
PositionRows: TypeAlias = NDArray[np.float64]

STATE_TOPIC = "/joint_states"
LEADER_TOPIC = "/teleop/leader_joint_states"

JOINT_STATE = "sensor_msgs/msg/JointState"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
ARM_STATE = "diagnostic_msgs/msg/DiagnosticStatus"

# Encodings of raw images of 8 bits a channel (sensor_msgs/image_encodings.hpp): channels, and those that make RGB.
COLOURS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}

# A day of the arm's states at 50 Hz; they are held in memory, at most 40 bytes a joint.
MAX_SAMPLES = 4_500_000

# Stamps of a client whose clock was set meanwhile are no axis of time; then the time of recording counts.
MAX_CLOCK_ERROR_S = 0.5


class JointSample(NamedTuple):
    """Message with positions of joints; the stamp is 0 s where it has none."""

    log_s: float
    stamp_s: float
    names: tuple[str, ...]
    positions: tuple[float, ...]


@dataclass
class Samples:
    """Samples of a recording: images and marks by time [s since the epoch], limits [rad, m].

    Attributes:
        phases: of the policy of each arm, by its topic and time.
        left_out: topics of images that are no pictures, such as depths, with their encodings.
    """

    path: Path
    joints: dict[str, list[JointSample]] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    images: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    marks: list[tuple[float, str]] = field(default_factory=list)
    phases: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    robot: str = ""
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    calibrated: dict[str, tuple[float, float]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    unreadable: int = 0

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each joint, calibrated or else its limits [rad, m]."""
        return self.limits | self.calibrated

    def zeros_rad(self, joints: Sequence[str]) -> dict[str, float]:
        """Return the zero of each joint's degrees in lerobot: the middle of its calibrated range, else 0 [rad]."""
        return {name: sum(self.calibrated.get(name, (0.0, 0.0))) / 2.0 for name in joints}


def read_samples(path: Path, registry: Registry) -> Samples:
    """Read a recording, of images only their times; raises RecordingError."""
    samples = Samples(path)
    count = 0
    for message in messages(path):
        try:
            count += _take(samples, message, registry)
        except ProtocolError:
            samples.unreadable += 1
        if count > MAX_SAMPLES:
            raise RecordingError(path, f"must have at most {MAX_SAMPLES} states, goals and images; it has more")
    return samples


def _take(samples: Samples, message: RecordedMessage, registry: Registry) -> int:
    topic, type_name, log_s = message.topic, message.type_name, message.log_time_ns / 1e9
    is_sample = type_name in (JOINT_STATE, CONTROLLER_STATE, *IMAGES)
    if not is_sample and type_name != ARM_STATE and topic not in (EPISODE_TOPIC, LIMITS_TOPIC):
        return 0
    values = cdr.deserialize(registry, type_name, message.octets)
    if type_name in (JOINT_STATE, CONTROLLER_STATE):
        samples.types[topic] = type_name
        samples.joints.setdefault(topic, []).append(_joint_sample(values, type_name, log_s))
        return 1
    if type_name in IMAGES:
        # compressed_depth_image_transport names itself in the format of its images.
        encoding = values["encoding"] if type_name == RAW_IMAGE else values["format"]
        if (type_name == RAW_IMAGE and encoding not in COLOURS) or "compressedDepth" in encoding:
            samples.left_out[topic] = encoding
            return 0
        samples.images.setdefault(topic, []).append((log_s, _stamp_s(values)))
        return 1
    if topic == EPISODE_TOPIC and "data" in values:
        samples.marks.append((log_s, str(values["data"])))
        return 1
    if type_name == ARM_STATE and topic.endswith(POLICY_TOPIC):
        phases = [each["value"] for each in values["values"] if each["key"] == "phase"]
        samples.phases.setdefault(topic, []).extend((log_s, phase) for phase in phases)
    elif type_name == ARM_STATE and topic.endswith(ARM_STATE_TOPIC):
        if topic == ARM_STATE_TOPIC:
            samples.robot = values["hardware_id"]
        for each in values["values"]:
            if each["key"].startswith(CALIBRATED_RANGE):
                with contextlib.suppress(ValueError):
                    lower, upper = map(float, each["value"].split())
                    samples.calibrated[each["key"].removeprefix(CALIBRATED_RANGE)] = lower, upper
    elif topic == LIMITS_TOPIC:
        for limit in values.get("limits", ()):
            samples.limits[limit["joint_name"]] = limit["min_position"], limit["max_position"]
    return 0


def _joint_sample(values: dict[str, Any], type_name: str, log_s: float) -> JointSample:
    if type_name == JOINT_STATE:
        names, positions = values["name"], values["position"]
    else:
        names, positions = values["joint_names"], values["reference"]["positions"]
    return JointSample(log_s, _stamp_s(values), tuple(names), tuple(positions))


def _stamp_s(values: dict[str, Any]) -> float:
    stamp = values["header"]["stamp"]
    return float(stamp["sec"] + stamp["nanosec"] / 1e9)


def times_s(log_s: Sequence[float], stamp_s: Sequence[float]) -> Times:
    """Return the times of a topic's messages on the axis of the recording [s].

    Stamps, 0 for none, are even where the time of recording has the jitter of a network. They may be from another
    clock: its offset, the median over the topic, is subtracted.
    """
    logged, stamped = np.asarray(log_s, dtype=np.float64), np.asarray(stamp_s, dtype=np.float64)
    if not logged.size or np.any(stamped == 0.0):
        return logged
    late = logged - stamped
    offset_s = float(np.median(late))
    if np.max(np.abs(late - offset_s)) > MAX_CLOCK_ERROR_S:
        return logged
    return stamped + offset_s


def interventions(samples: Samples, at_s: Times) -> NDArray[np.bool_] | None:
    """Return True for each time [s since the epoch] at which a person had taken over; None without a policy."""
    policies = [phases for phases in samples.phases.values() if any(phase != PolicyPhase.IDLE for _, phase in phases)]
    result = np.zeros(len(at_s), dtype=np.bool_)
    for phases in policies:
        began_s = [-np.inf, *(log_s for log_s, _ in phases)]
        taken_over = np.array([False, *(phase == PolicyPhase.TAKEN_OVER for _, phase in phases)])
        result |= taken_over[np.searchsorted(began_s, at_s, side="right") - 1]
    return result if policies else None


def merged(topics: Sequence[Sequence[JointSample]]) -> list[JointSample]:
    """Return the messages of several topics as one sequence, each with the last known position of every joint."""
    known: dict[str, float] = {}
    result: list[JointSample] = []
    for sample in heapq.merge(*topics, key=lambda each: each.log_s):
        if len(sample.names) != len(sample.positions):
            continue
        known.update(zip(sample.names, sample.positions, strict=True))
        row = sample._replace(names=tuple(known), positions=tuple(known.values()))
        if result and sample.stamp_s and result[-1].stamp_s == sample.stamp_s:
            result[-1] = row
        else:
            result.append(row)
    return result


def series(samples: Sequence[JointSample], names: Sequence[str]) -> tuple[Times, PositionRows]:
    """Return times [s], increasing, and positions [rad, m] of shape (n, joints); incomplete messages are left out."""
    wanted = list(names)
    columns: dict[tuple[str, ...], list[int] | None] = {}
    chosen: list[JointSample] = []
    rows: list[list[float]] = []
    for sample in samples:
        if sample.names not in columns:
            known = set(wanted) <= set(sample.names)
            columns[sample.names] = [sample.names.index(name) for name in wanted] if known else None
        indices = columns[sample.names]
        if indices is None or len(sample.positions) != len(sample.names):
            continue
        chosen.append(sample)
        rows.append([sample.positions[index] for index in indices])
    times = times_s([sample.log_s for sample in chosen], [sample.stamp_s for sample in chosen])
    positions = np.asarray(rows, dtype=np.float64).reshape(len(rows), len(wanted))
    # Two messages of one time are one sample; interpolation needs increasing times.
    times, order = np.unique(times, return_index=True)
    finite = np.isfinite(positions[order]).all(axis=1)
    return times[finite], positions[order][finite]
