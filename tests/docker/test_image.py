"""The image, compose and the commands of docs/install.md as far as they can be read; docker/verify.sh tries them."""

import json
import re
import shlex
import shutil
import subprocess
from fnmatch import fnmatch
from typing import Any

import pytest
import yaml

from harness.server import ROOT
from harness.waiting import TIMEOUT_S
from server import cli
from server.config import PREFIX, Settings
from server.gateway.settings import ServerSettings

Instruction = tuple[str, str]


def instructions() -> list[Instruction]:
    text = re.sub(r"^#.*\n", "", (ROOT / "docker/Dockerfile").read_text(), flags=re.MULTILINE)
    lines = text.replace("\\\n", " ").splitlines()
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in lines) if word]


ALL = instructions()
STARTS = [number for number, (word, _) in enumerate(ALL) if word == "FROM"]
RUNTIME = dict(ALL[STARTS[-1] :])


def test_every_stage_has_the_same_base_and_a_tag_that_says_which() -> None:
    bases = {next(word for word in rest.split() if word[:2] != "--") for name, rest in ALL if name == "FROM"}
    (base,) = bases
    assert re.fullmatch(r"debian:[a-z]+-slim", base)


def test_packages_come_from_the_locks_alone() -> None:
    runs = [rest for word, rest in ALL if word == "RUN"]
    assert any("--require-hashes --requirement requirements.lock" in run for run in runs)
    assert any(run.startswith("npm ci") for run in runs)
    others = [run for run in runs if " install " in run and "apt-get" not in run and "--require-hashes" not in run]
    assert all("--no-deps ." in run for run in others)


def test_the_image_has_the_page_and_the_site_of_the_docs_as_built_in_it() -> None:
    copied = [rest.split()[-1] for word, rest in ALL if word == "COPY" and "--from=" in rest]
    assert {"server/page/dist/", "server/docs_site/"} <= set(copied)
    assert any(word == "RUN" and "mkdocs build" in rest for word, rest in ALL)


def test_make_installs_exactly_what_a_lock_names() -> None:
    """With dependencies pip 23 takes a newer coverage than the lock's for coverage[toml], and refuses it."""
    lines = (ROOT / "Makefile").read_text().splitlines()
    installs = [line for line in lines if ".lock" in line and " install " in line]
    assert len(installs) == 3
    assert all("--no-deps --require-hashes" in line for line in installs)


def test_the_server_is_nobody_in_particular_and_may_open_a_servo_adapter() -> None:
    assert RUNTIME["USER"] == "1000"
    (added,) = [rest for word, rest in ALL if word == "RUN" and "useradd" in rest]
    assert "useradd --uid 1000 --groups dialout" in added


def test_without_arguments_it_serves_the_simulated_arm_to_other_machines(capsys: pytest.CaptureFixture[str]) -> None:
    # Lists: no shell stands between a signal and the server.
    words = json.loads(RUNTIME["ENTRYPOINT"]) + json.loads(RUNTIME["CMD"])
    assert words == ["tini", "--", "armbridge", "serve", "--host", "0.0.0.0", "--insecure"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(["serve", "--help"])
    assert "--insecure" in capsys.readouterr().out


def test_its_port_is_the_one_that_the_server_takes() -> None:
    assert RUNTIME["EXPOSE"] == str(ServerSettings().port)


def test_its_health_is_asked_for_by_a_program_that_is_in_it() -> None:
    command = json.loads(RUNTIME["HEALTHCHECK"].partition("CMD ")[2])
    (copied,) = [rest for word, rest in ALL if word == "COPY" and "health.py" in rest]
    assert command == ["python", copied.split()[-1]]


def test_what_is_copied_is_let_into_the_build() -> None:
    let_in = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    sources = [rest.split()[:-1] for word, rest in ALL if word == "COPY" and "--from" not in rest]
    copied = [source.rstrip("/") for each in sources for source in each]
    assert [source for source in copied if not any(fnmatch(source, f"{name}*") for name in let_in)] == []
    assert [name for name in let_in if not (ROOT / name).exists()] == []


def test_what_is_left_out_of_the_lock_is_imported_when_it_is_wanted_or_by_none_of_ours() -> None:
    lines = (ROOT / "requirements-unneeded.txt").read_text().splitlines()
    names = [line for line in lines if line and not line.startswith("#")]
    lock = (ROOT / "requirements.lock").read_text()
    assert [name for name in names if re.search(rf"^{re.escape(name)}==", lock, re.MULTILINE)] == []
    modules = {name.replace("-", "_") for name in names} | {"IPython", "zmq", "dns"}
    # Not within a function.
    imported = re.compile(rf"^(?:from|import) (?:{'|'.join(map(re.escape, sorted(modules)))})\b", re.MULTILINE)
    sources = [path for room in ("protocol", "robot", "planners", "server") for path in (ROOT / room).rglob("*.py")]
    assert [str(path) for path in sources if imported.search(path.read_text())] == []


def test_the_scripts_are_well_formed() -> None:
    for name in ("verify.sh", "release.sh"):
        script = str(ROOT / "docker" / name)
        subprocess.run(["bash", "-n", script], check=True, timeout=TIMEOUT_S)
        if shutil.which("shellcheck") is not None:
            subprocess.run(["shellcheck", script], check=True, timeout=TIMEOUT_S)


TEXT = (ROOT / "docker/compose.yaml").read_text()
SERVICES: dict[str, Any] = yaml.safe_load(TEXT)["services"]


@pytest.mark.parametrize("name", ["simulated", "real"])
def test_a_server_has_no_more_rights_than_it_needs_and_is_open_to_its_own_machine_alone(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert not {"privileged", "cap_add", "network_mode", "pid", "user"} & service.keys()
    assert service["mem_limit"]
    assert service["pids_limit"]
    assert service["ports"] == ["${ARMBRIDGE_PUBLISH:-127.0.0.1:9090}:9090"]


def test_the_simulated_arm_alone_is_started_and_asks_for_no_token() -> None:
    assert [name for name, service in SERVICES.items() if "profiles" not in service] == ["simulated"]
    assert "devices" not in SERVICES["simulated"]
    assert re.findall(r"\$\{\w+:?\?", TEXT) == []


def test_the_real_arm_is_the_device_handed_in_and_has_a_token() -> None:
    assert "--insecure" not in SERVICES["real"]["command"]
    assert "ARMBRIDGE_ACCESS__TOKEN" in SERVICES["real"]["environment"]
    real = SERVICES["real"]
    (device,) = real["devices"]
    assert device.rpartition(":")[2] == real["command"][real["command"].index("--serial") + 1]


PAGE = (ROOT / "docs/install.md").read_text()
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines() if line[:7] == "docker "]


def of_armbridge(line: str) -> list[str]:
    """What a line that starts a container hands to the program in it."""
    words = shlex.split(line)
    if words[:2] == ["docker", "run"]:
        return words[words.index("armbridge") + 1 :]
    return words[words.index("real", words.index("run")) + 1 :] if "run" in words else []


OF_SERVERS = {name for service in SERVICES.values() for name in service["environment"]}

HANDED = [words for line in LINES if (words := of_armbridge(line))]


def test_the_program_in_the_container_knows_the_commands_and_their_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(HANDED) >= 5
    for words in HANDED:
        with pytest.raises(SystemExit, match="0"):
            cli.main([words[0], "--help"])
        known = re.findall(r"--[\w-]+", capsys.readouterr().out)
        assert [word for word in words if word.startswith("--") and word not in known] == [], words


def test_every_variable_is_one_of_the_settings() -> None:
    settings = Settings()
    for name in sorted({*re.findall(rf"{PREFIX}\w+__\w+", PAGE), *OF_SERVERS}):
        section, key = name.removeprefix(PREFIX).lower().split("__")
        assert key in type(getattr(settings, section)).model_fields, name


def test_a_name_of_the_machine_is_given_as_the_page_says(monkeypatch: pytest.MonkeyPatch) -> None:
    (value,) = re.findall(r"-e ARMBRIDGE_ACCESS__ALLOWED_HOSTS='([^']+)'", PAGE)
    monkeypatch.setenv("ARMBRIDGE_ACCESS__ALLOWED_HOSTS", value)
    assert Settings().access.allowed_hosts == ("lab-pc",)


def test_files_and_variables_are_those_of_the_page() -> None:
    assert [name for name in re.findall(r"`(docker/\w[\w.]*)`", PAGE) if not (ROOT / name).exists()] == []
    assert [name for name in sorted(set(re.findall(rf"{PREFIX}\w+", TEXT))) if f"| `{name}` |" not in PAGE] == []
