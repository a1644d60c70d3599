"""What fuzzing found, and sessions that are made up by chance: nothing is found in them, and what is wrong would be.

``FUZZ_BATCHES`` says how many batches are made up, of some 1,500 frames each; what is found is cut down to the frames
that it needs, and saved in build/fuzz as a file that the corpus may take.
"""

import hashlib
import os
from random import Random

import pytest

from harness.server import ROOT
from protocol.publication import Frame
from server.gateway.client_topics import ClientTopics
from tests.fuzz import target
from tests.fuzz.sessions import SessionMaker
from tests.fuzz.target import CORPUS, REGISTRY, parts_of, problem_of


def sessions(seed: int, number: int) -> list[bytes]:
    maker = SessionMaker(Random(seed), REGISTRY, [])
    return [maker.session() for _ in range(number)]


def test_a_seed_makes_the_same_sessions_again_and_a_binary_frame_may_have_every_byte() -> None:
    assert sessions(1, 5) == sessions(1, 5) != sessions(2, 5)
    frame = bytes(range(256)) + b"\xfe\x00\xfe\x01\xfe\xfe\xff\xff"
    ((control, played),) = parts_of(target.escape(frame) + b"\x02" + target.SEPARATOR)
    assert control == 2
    assert target.frame_of(played, binary=True) == frame


def test_no_input_of_the_corpus_is_a_find() -> None:
    inputs = {path.name: path.read_bytes() for path in CORPUS.iterdir()}
    assert len(inputs) > 10
    assert {name: problem for name, data in inputs.items() if (problem := problem_of(data))} == {}


@pytest.mark.parametrize("number", range(int(os.environ.get("FUZZ_BATCHES", "1"))))
def test_nothing_is_found_in_a_batch(number: int) -> None:
    maker = SessionMaker(Random(number), REGISTRY, [path.read_bytes() for path in sorted(CORPUS.iterdir())])
    for _ in range(46):
        data = maker.session()
        if problem := problem_of(data):
            find = target.cut_down(data)
            path = ROOT / "build" / "fuzz" / f"find_{hashlib.sha256(find).hexdigest()[:12]}"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(find)
            pytest.fail(f"{problem}; saved as {path}")


def test_an_error_that_the_server_logs_is_a_find_and_cut_down_to_its_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise KeyError("broken")

    monkeypatch.setattr(ClientTopics, "publish", fail)
    found = next(data for data in sessions(4, 40) if len(list(parts_of(data))) > 10 and problem_of(data))
    assert "KeyError" in (problem_of(found) or "")
    assert len(list(parts_of(target.cut_down(found)))) == 1


@pytest.mark.parametrize("data", [b'{"op":"publish","msg":{"data":NaN}}', b'{"op":"a"', b"[]", '{"op":"ä"}'.encode()])
def test_a_frame_to_a_client_that_browsers_cannot_read_is_a_find(data: bytes) -> None:
    with pytest.raises(target.FindError):
        target.check_sent(Frame(data, text=True))
