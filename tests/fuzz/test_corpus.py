"""What fuzzing found, and what it starts from: each input is played once in every test run."""

import pytest

from tests.fuzz.batches import CORPUS, Run, problem_of
from tests.fuzz.target import run_interface_file, run_session, run_stream, run_world


@pytest.mark.parametrize("run", [run_session, run_world, run_stream, run_interface_file])
def test_no_input_of_the_corpus_is_a_find(run: Run) -> None:
    inputs = {path.name: path.read_bytes() for path in CORPUS.iterdir()}
    assert len(inputs) > 10
    assert {name: problem for name, data in inputs.items() if (problem := problem_of(data, run))} == {}
