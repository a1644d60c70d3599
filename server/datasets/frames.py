"""Frames of an episode: states, actions and images at a fixed rate, or the reason why there are none."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.datasets.episodes import MAX_GAP_S, Episode
from server.datasets.samples import PositionRows, Times

# One frame has no motion.
MIN_FRAMES = 2

# Seconds since the epoch are exact to 0.2 us as float64; a frame at the very end counts.
TIME_TOLERANCE_S = 1e-6


class LeftOutError(Exception):
    """An episode that cannot be exported; the text is one sentence with the reason."""


@dataclass(frozen=True)
class Tracks:
    """Tracks of a recording by time [s]: positions (n, joints), actions, None for the next state, and images."""

    state_times_s: Times
    states: PositionRows
    action_times_s: Times | None
    actions: PositionRows | None
    image_times_s: Mapping[str, Times]
    action_name: str = ""

    def has_actions_in(self, episode: Episode) -> bool:
        times_s = self.action_times_s
        return times_s is not None and bool(((times_s >= episode.start_s) & (times_s <= episode.end_s)).any())


@dataclass(frozen=True)
class EpisodeFrames:
    """Frames of an episode: positions of shape (frames, joints), and by camera the index of each frame's image.

    Attributes:
        interventions: True in frames in which a person had taken over; None where no policy moved the arm.
    """

    task: str
    start_s: float
    states: PositionRows
    actions: PositionRows
    images: Mapping[str, NDArray[np.int64]]
    interventions: NDArray[np.bool_] | None = None

    @property
    def count(self) -> int:
        return len(self.states)


def frames_of(episode: Episode, tracks: Tracks, fps: int, max_gap_s: float = MAX_GAP_S) -> EpisodeFrames:
    """Return the frames of an episode: the first one where everything has begun, the others at a fixed rate after it.

    A state is interpolated between the measurements before and after the frame. Action and image are the last before
    it: later ones were not known then.

    Raises:
        LeftOutError: something is missing for longer than ``max_gap_s``, or there are fewer than `MIN_FRAMES` frames.
    """
    names = {"the states": tracks.state_times_s}
    if tracks.action_times_s is not None:
        names[f"the actions on {tracks.action_name}"] = tracks.action_times_s
    names |= {f"the images on {topic}": times for topic, times in tracks.image_times_s.items()}
    start_s = max(_begun(name, times, episode, max_gap_s) for name, times in names.items())
    within = tracks.state_times_s[tracks.state_times_s <= episode.end_s + TIME_TOLERANCE_S]
    end_s = min(episode.end_s, float(within[-1])) if within.size else start_s
    count = math.floor((end_s - start_s + TIME_TOLERANCE_S) * fps) + 1 if end_s >= start_s else 0
    # The last frame has no next state.
    usable = count - (tracks.actions is None)
    if usable < MIN_FRAMES:
        raise LeftOutError(f"it has {max(0, usable)} frames at {fps} a second, and needs {MIN_FRAMES}")
    first_and_last_s = start_s + np.array([0, count - 1]) / fps
    for name, times in names.items():
        gap_s, begun_s = _greatest_gap(times, first_and_last_s, interpolated=times is tracks.state_times_s)
        if gap_s > max_gap_s:
            raise LeftOutError(f"{name} have a gap of {gap_s:.1f} s, {begun_s - episode.start_s:.1f} s after it begins")
    if episode.end_s - end_s > max_gap_s:
        raise LeftOutError(f"the states end {episode.end_s - end_s:.1f} s before it does")
    # Not before: across a gap of years, as of a clock that was set, there are billions.
    at_s = start_s + np.arange(count) / fps
    states = np.column_stack([np.interp(at_s, tracks.state_times_s, column) for column in tracks.states.T])
    if tracks.actions is None or tracks.action_times_s is None:
        states, actions = states[:-1], states[1:]
    else:
        actions = tracks.actions[_last_before(tracks.action_times_s, at_s)]
    images = {topic: _last_before(times, at_s[:usable]) for topic, times in tracks.image_times_s.items()}
    return EpisodeFrames(episode.task, start_s, states, actions, images)


def is_gripper(joint: str) -> bool:
    """Return True if a joint is a gripper by its name, also with an arm's name ahead of it."""
    return joint == "gripper" or joint.endswith("_gripper")


def in_lerobot_units(
    positions: PositionRows,
    joints: Sequence[str],
    ranges: Mapping[str, tuple[float, float]],
    zeros_rad: Mapping[str, float],
) -> PositionRows:
    """Return positions of shape (n, joints) [rad] in degrees from zeros, grippers in percent of their ranges."""
    columns = []
    for name, column in zip(joints, positions.T, strict=True):
        if is_gripper(name):
            lower, upper = ranges[name]
            columns.append((column - lower) / (upper - lower) * 100.0)
        else:
            columns.append(np.degrees(column - zeros_rad[name]))
    return np.column_stack(columns)


def _begun(name: str, times: Times, episode: Episode, max_gap_s: float) -> float:
    """Return the time in the episode from which there is something; a sample before it counts without a gap."""
    after = int(np.searchsorted(times, episode.start_s - TIME_TOLERANCE_S))
    following_s = float(times[after]) if after < times.size else episode.end_s
    if after > 0 and following_s - times[after - 1] <= max_gap_s:
        return episode.start_s
    if after == times.size or following_s > episode.end_s:
        raise LeftOutError(f"{name} are missing")
    if following_s - episode.start_s > max_gap_s:
        raise LeftOutError(f"{name} begin {following_s - episode.start_s:.1f} s after it does")
    return max(episode.start_s, following_s)


def _greatest_gap(times: Times, first_and_last_s: Times, *, interpolated: bool) -> tuple[float, float]:
    """Return length and start of the longest gap between the samples that frames are made of [s]."""
    first, last = _last_before(times, first_and_last_s)
    after = min(int(np.searchsorted(times, first_and_last_s[1] - TIME_TOLERANCE_S)), times.size - 1)
    span = np.append(times[first : last + 1], times[after] if interpolated else first_and_last_s[1])
    gaps = np.diff(span)
    worst = int(np.argmax(gaps))
    return float(gaps[worst]), float(span[worst])


def _last_before(times: Times, at_s: Times) -> NDArray[np.int64]:
    """Return the index of the last sample at or before each time; the first one where there is none."""
    return np.maximum(np.searchsorted(times, at_s + TIME_TOLERANCE_S, side="right") - 1, 0)
