"""What the image is made of and how it starts, as far as it can be read; ``docker/verify.sh`` builds and tries it."""

import json
import re
import shutil
import subprocess
from fnmatch import fnmatch

import pytest

from harness.server import ROOT
from server import cli
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


def test_make_installs_exactly_what_a_lock_names() -> None:
    """With dependencies pip 23 takes a newer coverage than the lock's for coverage[toml], and refuses it."""
    installs = [
        line for line in (ROOT / "Makefile").read_text().splitlines() if ".lock" in line and " install " in line
    ]
    assert len(installs) == 3
    assert all("--no-deps --require-hashes" in line for line in installs)


def test_the_server_is_nobody_in_particular_and_may_open_a_servo_adapter() -> None:
    assert RUNTIME["USER"] == "armbridge"
    (added,) = [rest for word, rest in ALL if word == "RUN" and "useradd" in rest]
    assert "--groups dialout" in added


@pytest.mark.parametrize("instruction", ["ENTRYPOINT", "CMD"])
def test_no_shell_stands_between_a_signal_and_the_server(instruction: str) -> None:
    assert isinstance(json.loads(RUNTIME[instruction]), list)


def test_without_arguments_it_serves_the_simulated_arm_to_other_machines(capsys: pytest.CaptureFixture[str]) -> None:
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
    copied = [
        source.rstrip("/")
        for word, rest in ALL
        if word == "COPY" and "--from" not in rest
        for source in rest.split()[:-1]
    ]
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


@pytest.mark.parametrize("name", ["verify.sh", "release.sh"])
def test_the_scripts_are_well_formed(name: str) -> None:
    script = str(ROOT / "docker" / name)
    subprocess.run(["bash", "-n", script], check=True, timeout=30)
    if shutil.which("shellcheck") is not None:
        done = subprocess.run(["shellcheck", script], capture_output=True, text=True, timeout=60, check=False)
        assert done.stdout == ""
