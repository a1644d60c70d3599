"""roslibpy's own tests, from its source distribution, against the server in both dialects, by a transport of it each.

They are unchanged but for the port, and a wait where their connections have half a second to end. The other libraries'
packages have no tests in them: roslibjs (npm) and compas_fab (PyPI) run by scenarios of the same calls, in
test_roslib.py and test_compas_fab.py. None of the three speaks raw TCP.
"""

import json
import os
import sys
import tarfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from harness.server import RunningServer
from tests.clients.conftest import OF_DIALECT
from tests.helpers.programs import run

PACKAGE = f"roslibpy=={metadata.version('roslibpy')}"

# The port of which the tests make use.
PORT = "9090"

# Thirty connections end in a fixed time there, which a busy machine exceeds.
PAUSE = "    time.sleep(0.5)\n\n    # Assert connection status\n"
WAIT = "    while any(ros.is_connected for ros in clients):\n        time.sleep(0.01)\n"

# The action that the tests expect beside the server, as in ROS's demos; goals above this order last until they are
# cancelled.
FIBONACCI = {"action": "/fibonacci", "type": "example_interfaces/action/Fibonacci"}
SOON_DONE_ORDER = 4
SUCCEEDED, CANCELED = 4, 5


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the tests."""
    folder = tmp_path_factory.mktemp("roslibpy")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", PACKAGE]
    loaded = run(*command, cwd=folder, timeout_s=300)
    if loaded.returncode != 0:
        pytest.skip(f"PyPI cannot be reached: {loaded.stderr.strip().splitlines()[-1]}")
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        opened.extractall(folder, filter="data")
    (tests,) = folder.glob("*/tests")
    return tests


@contextmanager
def fibonacci(url: str) -> Iterator[None]:
    """Offer the action as a client."""
    with connect(url) as websocket:
        websocket.send(json.dumps({"op": "advertise_action", **FIBONACCI}))

        def finish(goal_id: object, status: int, sequence: list[int]) -> None:
            result = {"op": "action_result", "action": FIBONACCI["action"], "id": goal_id, "result": True}
            websocket.send(json.dumps({**result, "status": status, "values": {"sequence": sequence}}))

        def serve() -> None:
            with suppress(ConnectionClosed):
                for frame in websocket:
                    operation = json.loads(frame)
                    if operation["op"] == "cancel_action_goal":
                        finish(operation["id"], CANCELED, [])
                    elif operation["args"]["order"] <= SOON_DONE_ORDER:
                        sequence = [0, 1]
                        while len(sequence) <= operation["args"]["order"]:
                            sequence.append(sequence[-1] + sequence[-2])
                        finish(operation["id"], SUCCEEDED, sequence)

        thread = threading.Thread(target=serve)
        thread.start()
        yield
    thread.join()


@pytest.mark.parametrize(("dialect", "transport"), [("ros1", "twisted"), ("ros2", "asyncio")])
def test_the_tests_of_roslibpy_pass(
    source: Path, dialect: str, transport: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    server: RunningServer = request.getfixturevalue(OF_DIALECT[dialect])
    with fibonacci(server.url):
        for path in (source / "conftest.py", *(source / dialect).glob("*.py")):
            text = path.read_text().replace(PAUSE, WAIT)
            (tmp_path / path.name).write_text(text.replace(PORT, str(server.port)))
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", "."]
        done = run(*command, cwd=tmp_path, timeout_s=200, env={**os.environ, "ROSLIBPY_TRANSPORT": transport})
    assert done.returncode == 0, done.stdout
    assert "25 passed" in done.stdout
