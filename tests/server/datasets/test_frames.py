from dataclasses import replace

import numpy as np
import pytest

from server.datasets.episodes import Episode
from server.datasets.frames import LeftOutError, Tracks, frames_of, in_lerobot_units

TIMES_S = np.arange(0.0, 4.0001, 0.02)
TRACKS = Tracks(TIMES_S, 0.1 * TIMES_S[:, None], None, None, {})
EPISODE = Episode(1.0, 2.0, "go")


def left_out(tracks: Tracks, episode: Episode = EPISODE) -> str:
    with pytest.raises(LeftOutError) as caught:
        frames_of(episode, tracks, 10)
    return str(caught.value)


def test_states_are_interpolated_at_a_fixed_rate() -> None:
    frames = frames_of(EPISODE, replace(TRACKS, action_times_s=TIMES_S, actions=TRACKS.states), 30)
    assert frames.count == 31
    assert frames.states[:, 0] == pytest.approx(0.1 + 0.1 * np.arange(31) / 30)


def test_action_and_image_are_the_last_ones_before_the_frame() -> None:
    late_s = TIMES_S + 0.005
    tracks = replace(
        TRACKS, action_times_s=late_s, actions=np.arange(len(late_s))[:, None], image_times_s={"c": late_s}
    )
    frames = frames_of(EPISODE, tracks, 10)
    assert frames.start_s == 1.0
    assert frames.actions[:, 0].tolist() == [49 + 5 * n for n in range(11)]
    assert frames.images["c"].tolist() == [49 + 5 * n for n in range(11)]


def test_an_episode_begins_where_everything_has_begun() -> None:
    frames = frames_of(EPISODE, replace(TRACKS, image_times_s={"c": np.arange(1.3, 2.0, 0.1)}), 10)
    assert frames.start_s == pytest.approx(1.3)


GAP_S = np.delete(TIMES_S, np.flatnonzero((TIMES_S > 1.2) & (TIMES_S < 1.79)))
HOLED = replace(TRACKS, state_times_s=GAP_S, states=0.1 * GAP_S[:, None])

LEFT_OUT = {
    "a gap in the states": (HOLED, "the states have a gap of 0.6 s, 0.2 s after it begins"),
    "a gap in the images": (
        replace(TRACKS, image_times_s={"/c": GAP_S}),
        "the images on /c have a gap of 0.6 s, 0.2 s after it begins",
    ),
    "no image any more": (
        replace(TRACKS, image_times_s={"/c": TIMES_S[TIMES_S < 1.3]}),
        "the images on /c have a gap of 0.7 s, 0.3 s after it begins",
    ),
    "actions that begin late": (
        replace(TRACKS, action_times_s=TIMES_S[80:], actions=TRACKS.states[80:], action_name="/a"),
        "the actions on /a begin 0.6 s after it does",
    ),
    "no images": (replace(TRACKS, image_times_s={"/c": np.array([])}), "the images on /c are missing"),
    "states that end early": (
        replace(TRACKS, state_times_s=TIMES_S[:70], states=TRACKS.states[:70]),
        "the states end 0.6 s before it does",
    ),
}


@pytest.mark.parametrize(("tracks", "sentence"), LEFT_OUT.values(), ids=LEFT_OUT.keys())
def test_an_episode_with_something_missing_is_left_out_with_the_place(tracks: Tracks, sentence: str) -> None:
    assert left_out(tracks) == sentence


def test_a_topic_that_is_silent_between_episodes_begins_again_in_each() -> None:
    spoken_s = TIMES_S[(TIMES_S < 0.2) | (TIMES_S > 1.11)]
    frames = frames_of(EPISODE, replace(TRACKS, action_times_s=spoken_s, actions=spoken_s[:, None]), 10)
    assert frames.start_s == pytest.approx(1.12)
    assert frames.actions[:, 0] == pytest.approx(1.12 + np.arange(9) / 10)


def test_an_episode_of_one_frame_is_left_out_and_one_beside_a_gap_is_not() -> None:
    assert left_out(TRACKS, Episode(1.0, 1.15, "")) == "it has 1 frames at 10 a second, and needs 2"
    assert frames_of(Episode(2.0, 3.0, ""), HOLED, 10).count == 10


def test_units_of_lerobot_are_degrees_from_the_zero_and_percent_of_the_grippers_range() -> None:
    positions = np.array([[np.pi / 2, 0.5, 0.5]])
    joints = ("shoulder_pan", "gripper", "left_gripper")
    ranges = {"gripper": (0.0, 2.0), "left_gripper": (-0.5, 1.5)}
    for zero_rad, degrees in ((0.0, 90.0), (np.pi / 4, 45.0)):
        zeros_rad = {"shoulder_pan": zero_rad, "gripper": 1.0}
        found = in_lerobot_units(positions, joints, ranges, zeros_rad)[0]
        assert found == pytest.approx([degrees, 25.0, 50.0])
