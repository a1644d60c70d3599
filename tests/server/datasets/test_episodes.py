from __future__ import annotations

import pytest

from server.datasets.episodes import MAX_TASK_CHARACTERS, START, Episode, Mark, episodes_of, parse_mark

MARKS: dict[str, tuple[list[tuple[float, str]], list[Episode]]] = {
    "a recording without marks is one episode": ([], [Episode(0.0, 9.0, "")]),
    "an episode lasts from start to stop and has the task of its start": (
        [(1.0, "start pick the cube"), (3.0, "stop"), (4.0, "start"), (6.0, "stop")],
        [Episode(1.0, 3.0, "pick the cube"), Episode(4.0, 6.0, "")],
    ),
    "a discard drops the episode in progress": (
        [(1.0, "start"), (2.0, "discard"), (3.0, "start"), (4.0, "stop")],
        [Episode(3.0, 4.0, "")],
    ),
    "a discard between episodes drops the last one": (
        [(1.0, "start"), (2.0, "stop"), (3.0, "start"), (4.0, "stop"), (5.0, "discard")],
        [Episode(1.0, 2.0, "")],
    ),
    "a recording whose episodes are all discarded has none": ([(1.0, "start"), (2.0, "discard")], []),
}


@pytest.mark.parametrize(("marks", "episodes"), MARKS.values(), ids=MARKS.keys())
def test_marks_make_episodes(marks: list[tuple[float, str]], episodes: list[Episode]) -> None:
    assert episodes_of(marks, 0.0, 9.0) == (episodes, [])


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
    for mark in (Mark(START), Mark(START, "pick the cube")):
        assert parse_mark(mark.text) == mark
    with pytest.raises(ValueError, match=f"task: must have at most {MAX_TASK_CHARACTERS} characters, not 301"):
        parse_mark("start " + "x" * 301)
