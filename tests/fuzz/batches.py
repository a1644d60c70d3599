"""Batches of made-up sessions, played and searched for finds."""

import faulthandler
import resource
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import TypeAlias

from tests.fuzz.sessions import SessionMaker
from tests.fuzz.target import REGISTRY, SEPARATOR, run_interface_file, run_stream, run_world

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"

Run: TypeAlias = Callable[[bytes], None]

SESSIONS_PER_BATCH = 50

# One in ten is a stream of raw TCP or an interface file.
OTHERS_EVERY = 10

# A batch takes a second; on a busy machine much longer, but never without an end.
STUCK_S = 300.0


def problem_of(data: bytes, run: Run = run_world) -> str | None:
    """Return the kind of find that some bytes are, None for none: the error and where it was raised."""
    try:
        run(data)
    except Exception as error:  # noqa: BLE001 - every one is a find
        cause = error.__cause__ or error
        trace = cause.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        place = "" if trace is None else f" in {trace.tb_frame.f_code.co_qualname}, line {trace.tb_lineno}"
        return f"{type(error).__name__}: {str(error)[:300]}; {type(cause).__name__}{place}"
    return None


def cut_down(data: bytes, run: Run = run_world) -> bytes:
    """Leave frames or lines out, as long as the same kind of find remains."""
    kind = kind_of(problem_of(data, run))
    separator = SEPARATOR if run is run_world else b"\n"
    parts = data.split(separator)
    size = len(parts) // 2
    while size:
        start = 0
        while start < len(parts):
            shorter = parts[:start] + parts[start + size :]
            if kind_of(problem_of(separator.join(shorter), run)) == kind:
                parts = shorter
            else:
                start += size
        size //= 2
    return separator.join(parts)


def kind_of(problem: str | None) -> str:
    """Return what finds of one kind have in common: the error and where it was raised; empty for no find."""
    return "" if problem is None else problem.rpartition(";")[2]


@dataclass(frozen=True)
class Batch:
    """What came of a batch.

    Attributes:
        frames: number of frames that were played.
        finds: sessions that are finds, cut down, by their kind, each with its problem.
        memory_mb: most memory that the process has had.
    """

    frames: int
    finds: dict[str, tuple[str, bytes]]
    memory_mb: float


class Player:
    """Player of batches, one in each process.

    Args:
        seed: of the run.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._corpus = [path.read_bytes() for path in sorted(CORPUS.iterdir())]

    def play(self, number: int) -> Batch:
        """Play one batch."""
        faulthandler.dump_traceback_later(STUCK_S)
        maker = SessionMaker(Random(f"{self._seed}:{number}"), REGISTRY, self._corpus)
        frames, finds = 0, dict[str, tuple[str, bytes]]()
        for session in range(SESSIONS_PER_BATCH):
            make, run = maker.session, run_world
            if session % OTHERS_EVERY == 0:
                make, run = (maker.stream, run_stream) if number % 2 else (maker.interface_file, run_interface_file)
            data, count = make()
            frames += count
            problem = problem_of(data, run)
            if problem is not None and kind_of(problem) not in finds:
                finds[kind_of(problem)] = problem, cut_down(data, run)
        faulthandler.cancel_dump_traceback_later()
        return Batch(frames, finds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


_player: Player


def start(seed: int) -> None:
    """Prepare a process for the batches of a run."""
    global _player
    _player = Player(seed)


def play_batch(number: int) -> Batch:
    """Play a batch in a process that has been prepared."""
    return _player.play(number)
