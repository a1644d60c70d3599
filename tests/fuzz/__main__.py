"""Fuzz a server's clients with as many frames as are asked for: ``python -m tests.fuzz --frames 10000000 --jobs 2``.

Sessions of four clients are made up by chance and played, in batches; the seed and its number tell all of a batch.
Streams of raw TCP and interface files are among them.
Each find is cut down to the frames that it needs and saved as a file that the corpus may take.
``coverage run -m tests.fuzz`` counts the lines that sessions reach.
"""

import argparse
import hashlib
import itertools
import multiprocessing
import sys
import time
from collections import deque
from pathlib import Path

from tests.fuzz.batches import STUCK_S, Batch, play_batch, start


def main(arguments: list[str] | None = None) -> int:
    """Fuzz, print how it goes, and return 1 if there was a find."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames to play (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed plays the same sessions")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side (default: %(default)s)")
    parser.add_argument(
        "--finds", type=Path, default=Path("build/fuzz"), help="folder for finds (default: %(default)s)"
    )
    parser.add_argument("--every", type=float, default=60.0, help="time between two lines of progress [s]")
    options = parser.parse_args(arguments)
    progress = Progress(options.finds, options.every)
    with multiprocessing.get_context("forkserver").Pool(options.jobs, start, (options.seed,)) as pool:
        # As many batches wait as keep the processes busy: imap would make all of the numbers at once.
        waiting = deque(pool.apply_async(play_batch, (number,)) for number in range(2 * options.jobs))
        for number in itertools.count(len(waiting)):
            progress.add(waiting.popleft().get(2 * STUCK_S))
            if progress.frames >= options.frames:
                break
            waiting.append(pool.apply_async(play_batch, (number,)))
        pool.terminate()
    progress.tell()
    return 1 if progress.finds else 0


class Progress:
    """Sum of the batches.

    Args:
        folder: where finds are saved.
        every_s: time between two lines of progress [s].

    Attributes:
        frames: number of frames that were played.
        finds: their files, by kind.
    """

    def __init__(self, folder: Path, every_s: float) -> None:
        self._folder = folder
        self._every_s = every_s
        self.frames = 0
        self.finds: dict[str, Path] = {}
        self._memory_mb = 0.0
        self._started_s = self._told_s = time.monotonic()
        self._told_frames = 0

    def add(self, batch: Batch) -> None:
        """Add a batch; save and print its finds."""
        self.frames += batch.frames
        self._memory_mb = max(self._memory_mb, batch.memory_mb)
        for kind, (problem, data) in batch.finds.items():
            if kind not in self.finds:
                self._folder.mkdir(parents=True, exist_ok=True)
                self.finds[kind] = self._folder / f"find_{hashlib.sha256(data).hexdigest()[:12]}"
                self.finds[kind].write_bytes(data)
                print(f"FIND after {self.frames} frames: {problem}; saved as {self.finds[kind]}", flush=True)
        if time.monotonic() - self._told_s >= self._every_s:
            self.tell()

    def tell(self) -> None:
        """Print how far it is."""
        now_s = time.monotonic()
        speed = (self.frames - self._told_frames) / max(now_s - self._told_s, 1e-3)
        print(
            f"{self.frames} frames in {now_s - self._started_s:.0f} s, now {speed:.0f} frames/s; "
            f"{self._memory_mb:.0f} MB a process; {len(self.finds)} kinds of finds",
            flush=True,
        )
        self._told_s, self._told_frames = now_s, self.frames


if __name__ == "__main__":
    sys.exit(main())
