from __future__ import annotations

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
    held = b"x" * (40 << 20)
    after = process_figures(os.getpid())
    release.set()
    for thread in threads:
        thread.join()
    for end in ends:
        os.close(end)
    assert before is not None
    assert after is not None
    assert after.threads - before.threads == 3
    assert after.open_files - before.open_files == 2
    assert len(held) * 0.9 < after.resident_bytes - before.resident_bytes < len(held) * 1.5
    assert 0.0 < before.cpu_s <= after.cpu_s < 1e5


def test_a_process_that_has_ended_uses_nothing() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait(10.0)
    assert process_figures(child.pid) is None
