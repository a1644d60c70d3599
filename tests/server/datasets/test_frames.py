from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from server.datasets.episodes import Episode
from server.datasets.frames import LeftOutError, Tracks, frames_of, in_lerobot_units

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


def test_an_episode_of_one_frame_is_left_out_and_one_beside_a_gap_is_not() -> None:
    with pytest.raises(LeftOutError, match="it has 1 frames at 10 a second, and needs 2"):
        frames_of(Episode(1.0, 1.15, ""), TRACKS, 10)
    assert frames_of(Episode(2.0, 3.0, ""), replace(TRACKS, **LEFT_OUT[0][0]), 10).count == 10


def test_an_episode_begins_where_everything_has_begun_also_after_a_silence_before_it() -> None:
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
