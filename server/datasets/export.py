"""Export of a recording: what was recorded, made into the frames and videos of a dataset."""

import hashlib
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from protocol.registry import Registry
from server.datasets import lerobot
from server.datasets.episodes import IMAGES, MAX_GAP_S, Episode, checked_task, episodes_of
from server.datasets.frames import EpisodeFrames, LeftOutError, Tracks, frames_of, in_lerobot_units, is_gripper
from server.datasets.lerobot import ImageStatistics, VideoError, VideoWriter, pixels_of
from server.datasets.samples import (
    CONTROLLER_STATE,
    JOINT_STATE,
    LEADER_TOPIC,
    STATE_TOPIC,
    JointSample,
    Samples,
    interventions,
    merged,
    read_samples,
    series,
    times_s,
)
from server.errors import ServerError
from server.recording.reading import messages

# Parts of an image topic's name that are about its transport, not about its camera.
_TRANSPORT = frozenset({"image", "image_raw", "image_color", "image_rect", "compressed", "color", "rgb"})

# Arm, units, calibration and zeros of a dataset; lerobot reads other files.
ARM_PATH = "meta/armbridge.json"

NO_TASK = "no task named"
NEXT_STATE = "the next state"

Report = Callable[[str], None]


class ExportError(ServerError):
    """A recording that makes no dataset; the text is one sentence."""


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export; actions are the topic's, else, an episode, the leader's, controllers' or the next state."""

    recording: Path
    output: Path
    fps: int = 30
    task: str | None = None
    action_topic: str | None = None
    state_topic: str | None = None
    units: Literal["rad", "lerobot"] = "rad"
    video: bool = True
    max_gap_s: float = MAX_GAP_S


@dataclass(frozen=True)
class Exported:
    """Outcome of an export."""

    episodes: int
    frames: int
    cameras: tuple[str, ...]
    actions: str
    problems: tuple[str, ...]


def export(options: ExportOptions, registry: Registry, report: Report) -> Exported:
    """Write a dataset of a recording; raises ServerError and OSError."""
    _check(options)
    path, problems = options.recording, list[str]()
    samples = read_samples(path, registry)
    state_topic = _state_topic(samples, options)
    # One of several arms may have connected after the first message.
    joints = max((each.names for each in samples.joints[state_topic]), key=len)
    topics = camera_keys(samples.images) if options.video else {}
    if topics and find_spec("av") is None:
        raise ExportError("videos need av: pip install 'armbridge[datasets]', or --no-video")
    found = _episodes_of(samples, state_topic, joints, topics, options, problems)
    episodes = [_in_units(frames, joints, samples, options) for frames, _ in found]
    for topic, encoding in samples.left_out.items() if options.video else ():
        report(f"{path}: {topic} is left out: its images are {encoding}")
    count = sum(each.count for each in episodes)
    report(f"{path}: {len(episodes)} episodes, {count} frames")
    if not episodes:
        reasons = f"{'; '.join(problems)}; gaps are allowed up to --max-gap" if problems else "none is left"
        raise ExportError(f"no episode can be exported: {reasons}")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.output.parent, prefix=f".{options.output.name}-") as folder:
        # A dataset is complete or absent.
        root = Path(folder) / "dataset"
        root.mkdir()
        if topics:
            report(f"{path}: writing {len(topics)} videos ...")
        cameras = _write_videos(root, topics, episodes, options, registry)
        lerobot.write(root, lerobot.Dataset(options.fps, joints, samples.robot or None, episodes, cameras))
        lerobot.write_json(root, ARM_PATH, _arm_of(samples, joints, options))
        root.rename(options.output)
    actions = Counter(name for _, name in found)
    named = ", ".join(actions) if len(actions) == 1 else ", ".join(f"{name} ({n})" for name, n in actions.items())
    return Exported(len(episodes), count, tuple(cameras), named, tuple(problems))


def _check(options: ExportOptions) -> None:
    if options.output.exists():
        raise ExportError(f"{options.output} exists already: name another folder (--output)")
    if find_spec("pyarrow") is None:
        raise ExportError("an export needs pyarrow: pip install 'armbridge[datasets]'")
    checked_task(options.task or "")


def _episodes_of(
    samples: Samples,
    state_topic: str,
    joints: tuple[str, ...],
    cameras: Mapping[str, str],
    options: ExportOptions,
    problems: list[str],
) -> list[tuple[EpisodeFrames, str]]:
    """Return the frames of episodes, and the name of their actions; ``problems`` gets the sentences about others."""
    states_s, states = series(samples.joints[state_topic], joints)
    if not states_s.size:
        raise ExportError(f"{samples.path}: {state_topic} must have the joints {', '.join(joints)}")
    # From the first state on: times since then are short, and exact.
    zero_s = float(states_s[0])
    image_times_s = {
        key: np.maximum.accumulate(times_s(*zip(*samples.images[topic], strict=True))) - zero_s
        for key, topic in cameras.items()
    }
    commanded: list[Tracks] = []
    for name, action_samples in _actions(samples, joints, options.action_topic):
        action_s, actions = series(action_samples, joints)
        commanded.append(Tracks(states_s - zero_s, states, action_s - zero_s, actions, image_times_s, name))
    next_state = Tracks(states_s - zero_s, states, None, None, image_times_s, NEXT_STATE)
    marks = [(at_s - zero_s, text) for at_s, text in samples.marks]
    episodes, notes = episodes_of(marks, 0.0, float(states_s[-1]) - zero_s)
    problems += notes
    if samples.unreadable:
        problems.append(f"{samples.unreadable} messages do not fit their types and are left out")
    found: list[tuple[EpisodeFrames, str]] = []
    for number, episode in enumerate(episodes, 1):
        try:
            tasked = replace(episode, task=episode.task or options.task or NO_TASK)
            frames, actions_of = _frames_of(tasked, commanded, next_state, options)
        except LeftOutError as error:
            where = f"episode {number} ({episode.start_s:.1f} to {episode.end_s:.1f} s)"
            problems.append(f"{where} is left out: {error}")
        else:
            at_s = zero_s + frames.start_s + np.arange(frames.count) / options.fps
            found.append((replace(frames, interventions=interventions(samples, at_s)), actions_of))
    return found


def _state_topic(samples: Samples, options: ExportOptions) -> str:
    """Return the topic of the states: the option's, the server's own, or the only topic of states."""
    found = sorted(name for name, kind in samples.types.items() if kind == JOINT_STATE and name != LEADER_TOPIC)
    wanted = options.state_topic or (found[0] if len(found) == 1 else STATE_TOPIC)
    if wanted not in found:
        known = f": --state-topic must be one of {', '.join(found)}" if found else ""
        raise ExportError(f"{samples.path}: has no messages of sensor_msgs/JointState on {wanted}{known}")
    return wanted


def _frames_of(
    episode: Episode, commanded: Sequence[Tracks], next_state: Tracks, options: ExportOptions
) -> tuple[EpisodeFrames, str]:
    """Return frames of the first tracks that an episode can be made of, and the name of their actions."""
    named = options.action_topic is not None
    present = [tracks for tracks in commanded if named or tracks.has_actions_in(episode)] or [next_state]
    for tracks in present:
        with suppress(LeftOutError):
            return frames_of(episode, tracks, options.fps, options.max_gap_s), tracks.action_name
    # The reason for the preferred tracks is the one to report.
    return frames_of(episode, present[0], options.fps, options.max_gap_s), present[0].action_name


def _actions(samples: Samples, joints: Sequence[str], topic: str | None) -> Iterator[tuple[str, Sequence[JointSample]]]:
    """Yield names and messages of the sources of actions, the preferred first."""
    if topic is not None and topic not in samples.joints:
        known = ", ".join(sorted(samples.joints))
        raise ExportError(f"{samples.path}: --action-topic must be one of {known}, not {topic}")
    for name in [topic] if topic is not None else [LEADER_TOPIC] if LEADER_TOPIC in samples.joints else []:
        chosen = samples.joints[name]
        missing = set(joints) - {joint for sample in chosen for joint in sample.names}
        # A leader or a program may command the arm alone; the gripper has a controller of its own.
        others = _controllers(samples, sorted(missing))
        if missing and not others and topic is not None:
            raise ExportError(f"{samples.path}: --action-topic {topic} has no {', '.join(sorted(missing))}")
        added = [[_only(sample, missing) for sample in samples.joints[each]] for each in others]
        yield " and ".join([name, *others]), merged([chosen, *added]) if added else chosen
    if topic is None and (controllers := _controllers(samples, joints)):
        yield " and ".join(controllers), merged([samples.joints[name] for name in controllers])


def _only(sample: JointSample, joints: Collection[str]) -> JointSample:
    kept = [pair for pair in zip(sample.names, sample.positions, strict=False) if pair[0] in joints]
    return sample._replace(names=tuple(name for name, _ in kept), positions=tuple(value for _, value in kept))


def _controllers(samples: Samples, joints: Sequence[str]) -> list[str]:
    """Return the topics of as few controllers as have the commanded positions of all joints; none without those."""
    commanded = {
        name: set(samples.joints[name][0].names) & set(joints)
        for name, type_name in sorted(samples.types.items())
        if type_name == CONTROLLER_STATE
    }
    chosen: list[str] = []
    left = set(joints)
    for name in sorted(commanded, key=lambda each: -len(commanded[each])):
        if commanded[name] & left:
            chosen.append(name)
            left -= commanded[name]
    return [] if left else chosen


def _in_units(frames: EpisodeFrames, joints: Sequence[str], samples: Samples, options: ExportOptions) -> EpisodeFrames:
    if options.units == "rad":
        return frames
    ranges, zeros_rad = samples.ranges, samples.zeros_rad(joints)
    missing = [name for name in joints if is_gripper(name) and name not in ranges]
    if missing:
        needed = f"the range of {', '.join(missing)}, as on /arm/joint_limits, which was not recorded"
        raise ExportError(f"{samples.path}: --units lerobot needs {needed}")
    states = in_lerobot_units(frames.states, joints, ranges, zeros_rad)
    return replace(frames, states=states, actions=in_lerobot_units(frames.actions, joints, ranges, zeros_rad))


def _arm_of(samples: Samples, joints: Sequence[str], options: ExportOptions) -> dict[str, Any]:
    """Return the contents of ``meta/armbridge.json``."""
    calibrated = "\n".join(f"{name} {lower:.5f} {upper:.5f}" for name, (lower, upper) in samples.calibrated.items())
    return {
        "robot": samples.robot,
        "units": options.units,
        "calibration": hashlib.sha256(calibrated.encode()).hexdigest()[:12] if calibrated else "",
        "joints": {
            name: {"zero_rad": zero_rad, "range_rad": samples.ranges.get(name), "limits_rad": samples.limits.get(name)}
            for name, zero_rad in samples.zeros_rad(joints).items()
        },
    }


def camera_keys(topics: Iterable[str]) -> dict[str, str]:
    """Return the key of each camera's video -> its topic: ``/wrist/image_raw/compressed`` is the camera ``wrist``."""
    keys: dict[str, str] = {}
    # image_transport publishes the same pictures raw and compressed.
    for topic in sorted(set(topics) - {each.removesuffix("/compressed") for each in topics if "/compressed" in each}):
        whole = [part for part in topic.split("/") if part]
        parts = [part for part in whole if part not in _TRANSPORT]
        key = lerobot.CAMERA_PREFIX + ("_".join(parts) or "camera")
        keys[lerobot.CAMERA_PREFIX + "_".join(whole) if key in keys else key] = topic
    return keys


def _write_videos(
    root: Path, topics: Mapping[str, str], episodes: Sequence[EpisodeFrames], options: ExportOptions, registry: Registry
) -> dict[str, lerobot.CameraVideo]:
    """Write the video of each camera; return them by the cameras' keys."""
    # Camera -> image -> episodes that show it, each with the number of its frames.
    shown: dict[str, dict[int, list[tuple[int, int]]]] = {key: {} for key in topics}
    for number, episode in enumerate(episodes):
        for key, indices in episode.images.items():
            for index, times in zip(*np.unique(indices, return_counts=True), strict=True):
                shown[key].setdefault(int(index), []).append((number, int(times)))
    statistics = {key: [ImageStatistics() for _ in episodes] for key in topics}
    with ExitStack() as stack:
        writers = {
            key: stack.enter_context(VideoWriter(lerobot.made_file(root, lerobot.VIDEO_PATH, key), options.fps))
            for key in topics
        }
        for key, index, values in _images(topics, options.recording, registry) if topics else ():
            if uses := shown[key].get(index):
                try:
                    image = pixels_of(values)
                    for number, times in uses:
                        writers[key].add(image, times)
                        statistics[key][number].add(image, times)
                except VideoError as error:
                    raise ExportError(f"{options.recording}: image {index + 1} of {topics[key]}: {error}") from error
    return {key: lerobot.CameraVideo(*writer.shape, statistics[key]) for key, writer in writers.items()}


def _images(topics: Mapping[str, str], path: Path, registry: Registry) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Yield the images of cameras, each with its camera's key and its number."""
    keys = {topic: key for key, topic in topics.items()}
    seen = Counter[str]()
    for message in messages(path):
        if message.type_name not in IMAGES or message.topic not in keys:
            continue
        try:
            values = cdr.deserialize(registry, message.type_name, message.octets)
        except ProtocolError:
            # It was not counted when the recording was read either.
            continue
        yield keys[message.topic], seen[message.topic], values
        seen[message.topic] += 1
