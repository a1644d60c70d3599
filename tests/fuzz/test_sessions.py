"""Sessions that are made up by chance: they can be made again, nothing is found in them, and what is wrong would be."""

from random import Random

import pytest

from protocol.framing import StreamSplitter
from protocol.publication import Frame
from server.gateway.client_topics import ClientTopics
from tests.fuzz.batches import cut_down, problem_of
from tests.fuzz.sessions import SessionMaker
from tests.fuzz.target import (
    REGISTRY,
    SEPARATOR,
    FindError,
    check_sent,
    escape,
    frame_of,
    parts_of,
    run_interface_file,
    run_stream,
)


def sessions(seed: int, number: int) -> list[bytes]:
    maker = SessionMaker(Random(seed), REGISTRY, [])
    return [maker.session()[0] for _ in range(number)]


def test_a_seed_makes_the_same_sessions_again() -> None:
    assert sessions(1, 5) == sessions(1, 5)
    assert sessions(1, 5) != sessions(2, 5)


def test_nothing_is_found_in_some_sessions() -> None:
    assert [problem for data in sessions(3, 40) if (problem := problem_of(data))] == []


def test_an_error_that_the_server_logs_and_survives_is_a_find_and_cut_down_to_its_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object) -> None:
        raise KeyError("broken")

    monkeypatch.setattr(ClientTopics, "publish", fail)
    found = next(data for data in sessions(4, 40) if len(list(parts_of(data))) > 10 and problem_of(data))
    assert "KeyError" in (problem_of(found) or "")
    assert len(list(parts_of(cut_down(found)))) == 1


@pytest.mark.parametrize("data", [b'{"op":"publish","msg":{"data":NaN}}', b'{"op":"a"', b"[]", '{"op":"ä"}'.encode()])
def test_a_frame_to_a_client_that_browsers_cannot_read_is_a_find(data: bytes) -> None:
    with pytest.raises(FindError):
        check_sent(Frame(data, text=True))


def test_a_binary_frame_may_have_every_byte() -> None:
    frame = bytes(range(256)) + b"\xfe\x00\xfe\x01\xfe\xfe\xff\xff"
    ((control, played),) = parts_of(escape(frame) + b"\x02" + SEPARATOR)
    assert control == 2
    assert frame_of(played, binary=True) == frame


def test_a_stream_that_is_cut_into_other_frames_when_it_comes_in_pieces_is_a_find(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    maker = SessionMaker(Random(5), REGISTRY, [])
    streams = [maker.stream()[0] for _ in range(60)]
    assert [problem for data in streams if (problem := problem_of(data, run_stream))] == []
    add = StreamSplitter.add
    monkeypatch.setattr(StreamSplitter, "add", lambda splitter, data: add(splitter, data[:100]))
    assert any(problem_of(data, run_stream) for data in streams)


def test_interface_files_are_made_up_and_taken() -> None:
    maker = SessionMaker(Random(6), REGISTRY, [])
    files = [maker.interface_file()[0] for _ in range(60)]
    assert any(b"---" in file for file in files)
    assert [problem for file in files if (problem := problem_of(file, run_interface_file))] == []
