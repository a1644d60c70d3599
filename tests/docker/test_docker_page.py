"""The commands of docs/install.md: the engine's own words are not run, ours are held against the program."""

import re
import shlex

import pytest
import yaml

from harness.server import ROOT
from server import cli
from server.config import PREFIX, Settings

PAGE = (ROOT / "docs/install.md").read_text()
LINES = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
    if line[:7] == "docker "
]


def of_armbridge(line: str) -> list[str]:
    """What a line that starts a container hands to the program in it."""
    words = shlex.split(line)
    if words[:2] == ["docker", "run"]:
        return words[words.index("armbridge") + 1 :]
    return words[words.index("real", words.index("run")) + 1 :] if "run" in words else []


COMPOSE = (ROOT / "docker/compose.yaml").read_text()
OF_SERVERS = {name for service in yaml.safe_load(COMPOSE)["services"].values() for name in service["environment"]}

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


def test_files_that_the_page_names_exist() -> None:
    assert [name for name in re.findall(r"`(docker/\w[\w.]*)`", PAGE) if not (ROOT / name).exists()] == []


def test_every_variable_of_the_compose_file_is_explained() -> None:
    assert [name for name in sorted(set(re.findall(rf"{PREFIX}\w+", COMPOSE))) if f"| `{name}` |" not in PAGE] == []
