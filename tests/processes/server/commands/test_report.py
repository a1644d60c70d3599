import io
import json
import stat
import zipfile
from pathlib import Path

import pytest

from harness.server import free_port, read_write_log
from robot.calibration import save
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.robots import nominal_calibration
from tests.server.commands.conftest import Run

TOKENS = {name: f"{name}-0123456789abcdef" for name in ("own", "admin", "filed", "variable")}


def members(file: Path | io.BytesIO) -> dict[str, str]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings with secrets wherever there can be some; nobody listens at their port."""
    tokens = tmp_path / "tokens.toml"
    tokens.write_text(f'view_tokens = {{ screen = "{TOKENS["filed"]}" }}\n')
    tokens.chmod(0o600)
    config = tmp_path / "armbridge.toml"
    config.write_text(
        f'[server]\nport = {free_port()}\n[access]\ntoken = "{TOKENS["own"]}"\ntoken_file = "{tokens}"\n'
        f'admin_tokens = {{ boss = "{TOKENS["admin"]}" }}\n'
        '[zenoh]\nconnect = ["tls/h:1#connect_private_key_base64=SECRETKEY"]\n'
    )
    monkeypatch.setenv("ARMBRIDGE_ACCESS__OPERATE_TOKENS", json.dumps({"desk": TOKENS["variable"]}))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("HOME", str(tmp_path))
    return config


def test_no_token_or_password_of_the_settings_is_in_any_member(file: Path, tmp_path: Path) -> None:
    faults = tmp_path / "data" / "armbridge" / "faults"
    faults.mkdir(parents=True)
    (faults / "fault-1.jsonl").write_text(" ".join(TOKENS.values()))
    output = tmp_path / "report.zip"
    serial = "socket://ada:hunter2@127.0.0.1:9"
    assert cli.main(["report", "--config", str(file), "--output", str(output), "--serial", serial]) == ExitCode.DONE
    told = members(output)
    assert {"settings.json", "versions.json", "arm/robot.toml", "faults/fault-1.jsonl"} <= told.keys()
    for name, text in told.items():
        for secret in ("0123456789abcdef", "SECRETKEY", "hunter2", str(tmp_path)):
            assert secret not in text, name


def test_on_a_machine_where_nothing_runs_there_is_a_report_of_what_there_is(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["report", "--config", str(file)]) == ExitCode.DONE
    (output,) = tmp_path.glob("armbridge-report-*.zip")
    said = capsys.readouterr()
    assert f"written to {output.name}" in said.out
    told = members(output)
    assert all(f"{name} (" in said.err for name in told)
    assert "none answers at 127.0.0.1:" in told["problems.txt"]
    assert "no port is named" in told["problems.txt"]
    assert stat.S_IMODE(output.stat().st_mode) == 0o600


def test_settings_that_are_refused_are_reported_and_a_file_that_is_there_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "report.zip"
    assert cli.main(["report", "--output", str(output), "--set", "goals.capacity=0"]) == ExitCode.DONE
    told = members(output)
    assert "settings: goals.capacity: " in told["problems.txt"]
    assert json.loads(told["settings.json"])["settings"]["goals"]["capacity"] == 16
    assert cli.main(["report", "--output", str(output)]) == ExitCode.FAILED
    assert "--output" in capsys.readouterr().err
    assert members(output) == told


def test_without_a_server_servos_are_only_read(armbridge: Run, file: Path, tmp_path: Path, write_log: Path) -> None:
    output, calibration = tmp_path / "report.zip", tmp_path / "arm.json"
    save(nominal_calibration(), calibration)
    options = "--config", str(file), "--output", str(output), "--calibration", str(calibration)
    assert armbridge("report", *options).returncode == ExitCode.DONE
    told = members(output)
    registers = json.loads(told["bus/registers.json"])
    assert list(registers) == ["1", "2", "3", "4", "5", "6"]
    assert registers["3"]["MODEL_NUMBER"] == 777
    assert registers["3"]["ID"] == 3
    checks = {finding["check"]: finding["verdict"] for finding in json.loads(told["bus/doctor.json"])}
    assert checks["servos"] == checks["calibration"] == "good"
    assert json.loads(told["arm/calibration.json"])["elbow_flex"]["id"] == 3
    assert read_write_log(write_log) == []
