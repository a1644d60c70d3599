import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.server import RunningServer
from harness.waiting import TIMEOUT_S, wait_until
from server import cli
from server.commands.terminal import ExitCode
from server.config import Settings
from server.monitoring import report
from server.monitoring.report import Redactor, Report, add_server
from tests.processes.server.commands.test_commands import members

TOKEN = "one-0123456789abcdef"
VIEW_TOKEN = "two-0123456789abcdef"


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """Wait for the answers of a server however busy the machine is."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("TIMEOUT_S", "DIAGNOSTICS_TIMEOUT_S"):
            patch.setattr(report, name, TIMEOUT_S)
        yield


@pytest.fixture(scope="module")
def port(patience: None) -> Iterator[int]:
    """The port of a server with tokens, whose servos have told their health."""
    tokens = {"ARMBRIDGE_ACCESS__TOKEN": TOKEN, "ARMBRIDGE_ACCESS__VIEW_TOKENS": json.dumps({"screen": VIEW_TOKEN})}
    with RunningServer(settings=tokens) as running:
        # Health comes once a second on the arm's clock, which is slow on a busy machine.
        wait_until(lambda: "arm: elbow_flex" in told_by(running.port, TOKEN)["server/diagnostics.json"])
        yield running.port


def told_by(port: int, token: str | None) -> dict[str, str]:
    """The members that a server adds to a report of somebody."""
    told = Report(Redactor([], Path("/nobody")))
    with told.part("server"):
        add_server(told, settings(port), token)
    return members(io.BytesIO(told.archive()))


def settings(port: int) -> Settings:
    return Settings(server={"port": port, "host": "0.0.0.0"})


def test_an_administrator_gets_state_diagnostics_and_log(port: int) -> None:
    told = told_by(port, TOKEN)
    assert "armbridge is ready" in told["server/log.txt"]
    assert "robot.control.loop armbridge.arm: " in told["server/log.txt"]
    assert json.loads(told["server/arm_state.json"])["name"] == "arm"
    assert "arm: elbow_flex" in [each["name"] for each in json.loads(told["server/diagnostics.json"])["status"]]
    history = json.loads(told["server/servo_history.json"])["elbow_flex"]
    assert len(history["temperature_c"]) == len(history["time_s"]) > 0
    assert "problems.txt" not in told


def test_a_viewer_gets_all_but_the_log_and_a_wrong_token_nothing(port: int) -> None:
    told = told_by(port, VIEW_TOKEN)
    assert "server/diagnostics.json" in told
    assert "server/log.txt" not in told
    assert "server/log.txt: service /armbridge/last_log_lines: needs the role admin" in told["problems.txt"]
    told = told_by(port, "three-0123456789abcdef")
    assert set(told) == {"problems.txt"}
    assert "server: server rejected WebSocket connection: HTTP 401" in told["problems.txt"]


def test_a_report_asks_a_running_server_instead_of_the_bus(
    port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", TOKEN)
    output = tmp_path / "report.zip"
    options = ["--output", str(output), "--port", str(port), "--serial", "/dev/none"]
    assert cli.main(["report", *options]) == ExitCode.DONE
    told = members(output)
    assert {"server/log.txt", "server/diagnostics.json"} <= told.keys()
    assert not [name for name in told if name.startswith("bus/")]
    assert "problems.txt" not in told
    assert TOKEN not in "".join(told.values())
