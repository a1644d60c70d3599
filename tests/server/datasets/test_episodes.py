from __future__ import annotations

import pytest

from server.datasets.episodes import MAX_TASK_CHARACTERS, START, Episode, Mark, episodes_of, parse_mark


def test_a_recording_without_marks_is_one_episode() -> None:
    assert episodes_of([], 0.0, 9.0) == ([Episode(0.0, 9.0, "")], [])


def test_an_episode_lasts_from_start_to_stop_and_has_the_task_of_its_start() -> None:
    marks = [(1.0, "start pick the cube"), (3.0, "stop"), (4.0, "start"), (6.0, "stop")]
    assert episodes_of(marks, 0.0, 9.0) == ([Episode(1.0, 3.0, "pick the cube"), Episode(4.0, 6.0, "")], [])


def test_a_discard_drops_the_episode_in_progress() -> None:
    assert episodes_of([(1.0, "start"), (2.0, "discard"), (3.0, "start"), (4.0, "stop")], 0.0, 9.0) == (
        [Episode(3.0, 4.0, "")],
        [],
    )


def test_a_discard_between_episodes_drops_the_last_one() -> None:
    marks = [(1.0, "start"), (2.0, "stop"), (3.0, "start"), (4.0, "stop"), (5.0, "discard")]
    assert episodes_of(marks, 0.0, 9.0) == ([Episode(1.0, 2.0, "")], [])


def test_a_recording_whose_episodes_are_all_discarded_has_none() -> None:
    assert episodes_of([(1.0, "start"), (2.0, "discard")], 0.0, 9.0) == ([], [])


ODD_MARKS = {
    "an episode that is not stopped": ([(1.0, "start")], 1, "was not stopped, and ends with the file"),
    "a start within an episode": ([(1.0, "start"), (2.0, "start"), (3.0, "stop")], 2, "within another"),
    "a stop without start": ([(1.0, "stop")], 0, "has no start"),
    "a discard of nothing": ([(1.0, "discard")], 0, "has no episode"),
    "another text": ([(1.0, "go")], 0, "data: must be 'start', 'start TASK', 'stop' or 'discard', not 'go'"),
}


@pytest.mark.parametrize(("marks", "count", "sentence"), ODD_MARKS.values(), ids=ODD_MARKS.keys())
def test_a_mark_that_does_not_fit_is_said(marks: list[tuple[float, str]], count: int, sentence: str) -> None:
    episodes, notes = episodes_of(marks, 0.0, 9.0)
    assert len(episodes) == count
    assert len(notes) == 1
    assert sentence in notes[0]


def test_a_task_is_one_line_and_a_long_one_is_refused_with_the_limit() -> None:
    assert parse_mark(" start  pick\n the cube ") == Mark(START, "pick the cube")
    with pytest.raises(ValueError, match=f"task: must have at most {MAX_TASK_CHARACTERS} characters, not 301"):
        parse_mark("start " + "x" * 301)


def test_the_text_of_a_mark_is_read_as_the_mark() -> None:
    for mark in (Mark(START), Mark(START, "pick the cube")):
        assert parse_mark(mark.text) == mark
