from __future__ import annotations

import mmap
import os
import subprocess
import sys
import threading

from server.operations.process_figures import process_figures


def test_what_this_process_uses_is_told() -> None:
    before = process_figures(os.getpid())
    release = threading.Event()
    threads = [threading.Thread(target=release.wait) for _ in range(3)]
    ends = os.pipe()
    for thread in threads:
        thread.start()
    # Not from the heap, which may have as much to spare from the tests before.
    held = mmap.mmap(-1, 40 << 20)
    held.write(bytes(len(held)))
    after = process_figures(os.getpid())
    release.set()
    for thread in threads:
        thread.join()
    for end in ends:
        os.close(end)
    size_bytes = len(held)
    held.close()
    assert before is not None
    assert after is not None
    assert after.threads - before.threads == 3
    assert after.open_files - before.open_files == 2
    assert 0.9 * size_bytes < after.resident_bytes - before.resident_bytes < 2.5 * size_bytes
    assert 0.0 < before.cpu_s <= after.cpu_s < 1e5


def test_a_process_that_has_ended_uses_nothing() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait(10.0)
    assert process_figures(child.pid) is None
