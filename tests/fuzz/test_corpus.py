"""What fuzzing found, and what it starts from: each input is played once in every test run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.target import run_interface_file, run_session, run_stream, run_world

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_an_input_of_the_corpus_is_taken_by_a_session(path: Path) -> None:
    run_session(path.read_bytes())


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_an_input_of_the_corpus_is_taken_by_a_graph(path: Path) -> None:
    run_world(path.read_bytes())


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_an_input_of_the_corpus_is_taken_as_a_stream_and_as_an_interface_file(path: Path) -> None:
    run_stream(path.read_bytes())
    run_interface_file(path.read_bytes())
