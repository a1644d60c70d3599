import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from harness.waiting import TIMEOUT_S, running
from robot import files
from robot.files import FileLock, FileLockedError, lock_path, locked, replace

HOLDER = """
import sys
from pathlib import Path
from robot.files import FileLock
FileLock(Path(sys.argv[1])).acquire()
lock = FileLock(Path(sys.argv[2]))
lock.acquire()
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "states.json"


def test_a_lock_that_another_process_has_is_refused_with_its_number_and_free_after_its_death(path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(path.with_name("other")), str(path)]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(FileLockedError) as raised:
            FileLock(path).acquire()
        assert raised.value.strerror == f"is in use by armbridge (process {holder.pid})"
        holder.kill()
        holder.wait(TIMEOUT_S)
        FileLock(path).acquire()


def test_a_lock_is_waited_for_no_longer_than_its_time_and_taken_when_it_is_given_back(path: Path) -> None:
    held = FileLock(path)
    held.acquire()
    times = iter((0.0, 1.0, 1.9, 2.0))
    with pytest.raises(FileLockedError):
        FileLock(path).acquire(2.0, lambda: next(times))
    assert list(times) == []
    threading.Timer(0.05, held.release).start()
    with locked(path):
        pass


def test_a_lock_keeps_threads_of_one_process_from_each_other(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LOCK_TIMEOUT_S", 0.0)
    with locked(path), pytest.raises(FileLockedError, match=str(os.getpid())), locked(path):
        pass
    with locked(path):
        pass


def test_all_names_of_a_file_have_one_lock(tmp_path: Path) -> None:
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "states.json")
    assert lock_path(link) == lock_path(tmp_path / "sub" / ".." / "states.json") == tmp_path / ".states.json.lock"


def test_a_file_is_replaced_as_a_whole_nothing_is_left_beside_it_and_a_symbolic_link_stays_one(tmp_path: Path) -> None:
    path, link = tmp_path / "states.json", tmp_path / "link.json"
    for content in (b"old", b"new"):
        replace(path, content)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"new", [path])
    link.symlink_to(path)
    replace(link, b"newer")
    assert (link.is_symlink(), path.read_bytes()) == (True, b"newer")


def test_what_cannot_be_written_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "states.json"
    replace(path, b"old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
