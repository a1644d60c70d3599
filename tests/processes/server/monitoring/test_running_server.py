import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.server import ServerOnBus, free_port, server_on_bus
from harness.waiting import wait_until
from server.config import Settings
from server.monitoring.report import Redactor, Report, RunningServer

TOKEN = "one-0123456789abcdef"
VIEW_TOKEN = "two-0123456789abcdef"


@pytest.fixture(scope="module")
def guarded() -> Iterator[ServerOnBus]:
    """A server with tokens, whose servos have told their health."""
    with server_on_bus(ACCESS__TOKEN=TOKEN, ACCESS__VIEW_TOKENS=json.dumps({"screen": VIEW_TOKEN})) as running:
        server = RunningServer(settings(running.server.port), TOKEN)
        # Health comes once a second on the arm's clock, which is slow on a busy machine.
        wait_until(lambda: "arm: elbow_flex" in told_by(server)[0]["server/diagnostics.json"])
        yield running


def settings(port: int) -> Settings:
    return Settings(server={"port": port, "host": "0.0.0.0"})


def told_by(server: RunningServer) -> tuple[dict[str, str], set[Path]]:
    report = Report(Redactor([], Path("/nobody")))
    directories = server.add_to(report)
    with zipfile.ZipFile(io.BytesIO(report.archive())) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}, directories


def test_an_administrator_gets_health_metrics_diagnostics_and_log(guarded: ServerOnBus) -> None:
    server = RunningServer(settings(guarded.server.port), TOKEN)
    assert server.runs
    told, _ = told_by(server)
    assert json.loads(told["server/health.json"])["live"]
    assert "armbridge_arm_mode" in told["server/metrics.txt"]
    assert "armbridge is ready" in told["server/log.txt"]
    assert json.loads(told["server/arm_state.json"])["name"] == "arm"
    names = [status["name"] for status in json.loads(told["server/diagnostics.json"])["status"]]
    assert "arm: elbow_flex" in names
    history = json.loads(told["server/servo_history.json"])["elbow_flex"]
    assert len(history["temperature_c"]) == len(history["time_s"]) > 0
    assert "problems.txt" not in told


def test_a_viewer_gets_all_but_the_log(guarded: ServerOnBus) -> None:
    told, _ = told_by(RunningServer(settings(guarded.server.port), VIEW_TOKEN))
    assert "server/diagnostics.json" in told
    assert "server/log.txt" not in told
    assert "its log is not returned" in told["problems.txt"]


def test_without_a_token_there_is_the_health_alone(guarded: ServerOnBus) -> None:
    told, directories = told_by(RunningServer(settings(guarded.server.port), None))
    assert [name for name in told if name.startswith("server/")] == ["server/health.json", "server/metrics.txt"]
    assert "armbridge_" not in told["server/metrics.txt"]
    assert "server/diagnostics.json" in told["problems.txt"]
    assert directories == set()


def test_a_port_where_nobody_listens_has_no_server() -> None:
    server = RunningServer(settings(free_port()), TOKEN)
    assert not server.runs
    assert server.address.startswith("127.0.0.1:")
