import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from server.config import Settings
from server.monitoring import report as report_module
from server.monitoring.report import PROBLEMS, README, Redactor, Report, add_faults, add_machine, add_settings

TOKEN = "one-0123456789abcdef"
LONGER = f"{TOKEN}-and-more"
QUOTED = 'quoted"and\\0123456789'
HOME = Path("/srv/people/ada")


@pytest.fixture
def report() -> Report:
    return Report(Redactor([TOKEN], HOME))


def members(report: Report) -> dict[str, str]:
    with zipfile.ZipFile(io.BytesIO(report.archive())) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


SECRETS = {
    f"it was {TOKEN}!": "it was ***!",
    # One that another one begins with, one that JSON escapes, and one of somebody else in an address.
    LONGER: "***",
    json.dumps({"x": QUOTED}): '{"x": "***"}',
    "GET /?token=other-secret&x=1": "GET /?token=***&x=1",
    "Authorization: Bearer abc.def": "Authorization: *** ***",
    '{"password": "hunter2", "x": 1}': '{"password": "***", "x": 1}',
    "socket://ada:hunter2@host:4000": "socket://***@host:4000",
    "tls/host:7447#connect_private_key_base64=AAAA;x=1": "tls/host:7447#connect_private_key_base64=***;x=1",
    "-----BEGIN RSA PRIVATE KEY-----\nAAAA\n-----END RSA PRIVATE KEY-----\n": "***\n",
    # The home directory, a folder whose name begins alike, and homes of others.
    "/srv/people/ada/arm.json": "~/arm.json",
    "/srv/people/ada2/arm.json": "/srv/people/ada2/arm.json",
    "/home/grace/arm.json and /home/grace": "/home/***/arm.json and /home/***",
}


def test_secrets_are_blotted_out() -> None:
    redactor = Redactor([TOKEN, LONGER, QUOTED], HOME)
    assert {text: redactor.text(text) for text in SECRETS} == SECRETS


def test_every_member_is_without_secrets_and_listed(report: Report, tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f"# {TOKEN}")
    report.add("server/log.txt", TOKEN)
    report.add_json("settings.json", {"x": [TOKEN]})
    report.add_file("arm/robot.toml", file)
    report.note(TOKEN)
    told = members(report)
    assert set(told) == {"server/log.txt", "settings.json", "arm/robot.toml", PROBLEMS, README}
    assert TOKEN not in "".join(told.values())
    listed = [line.partition(":")[0] for line in told[README].splitlines()[2:] if line]
    assert listed == ["settings.json", "arm/", "server/", PROBLEMS]


def test_settings_have_neither_tokens_nor_the_names_of_their_owners(report: Report) -> None:
    values: dict[str, Any] = {"access": {"token": TOKEN, "view_tokens": {"grace": "two-0123456789abcdef"}}}
    add_settings(report, Settings(**values), {"access.token": "file"})
    told = members(report)["settings.json"]
    assert "0123456789abcdef" not in told
    assert "grace" not in told
    assert json.loads(told)["settings"]["access"]["view_tokens"] == 1
    assert json.loads(told)["sources"] == {"access.token": "file"}


def test_what_fails_is_noted_and_the_rest_is_there(report: Report) -> None:
    with report.part("bus"):
        raise LookupError
    with report.part("arm"):
        report.add("arm/robot.toml", "name = 'x'")
    told = members(report)
    assert told[PROBLEMS] == "bus: LookupError\n"
    assert "arm/robot.toml" in told


def test_the_machine_is_told_by_versions_packages_and_ports(report: Report) -> None:
    add_machine(report)
    told = members(report)
    assert PROBLEMS not in told
    versions = json.loads(told["versions.json"])
    assert versions["armbridge"]
    assert versions["kernel"]
    assert "numpy==" in told["packages.txt"]
    assert isinstance(json.loads(told["ports.json"]), list)


def test_the_newest_fault_files_are_included(report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_module, "MAX_FAULT_BYTES", 250)
    (tmp_path / "other.jsonl").write_text("somebody else's")
    for number in range(4):
        (tmp_path / f"fault-{number}.jsonl").write_text("x" * 100)
    add_faults(report, tmp_path)
    told = members(report)
    assert [name for name in told if name.startswith("faults/")] == ["faults/fault-3.jsonl", "faults/fault-2.jsonl"]
    assert "left out" in told[PROBLEMS]
    add_faults(none := Report(Redactor([], HOME)), tmp_path / "none")
    assert set(members(none)) == {README}
