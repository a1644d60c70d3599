import re
import stat

import pytest

from harness.server import ROOT
from robot.files import FileLock, FileLockedError, replace
from server import cli
from server.access.authentication import Tokens
from server.access.settings import AccessSettings
from server.commands import certificate
from server.commands.certificate import add_certificate_parser, ensure_token
from server.commands.terminal import ExitCode
from server.errors import ConfigurationError
from server.graph.permissions import Role


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "armbridge" / "tls"


def test_it_says_where_the_files_are_and_what_to_do(folder, capsys):
    assert add_certificate_parser in cli.COMMANDS
    assert cli.main(["certificate", "--name", "arm.example"]) == ExitCode.DONE
    told = capsys.readouterr().out
    for name in ("server.pem", "server.key", "armbridge-authority.crt"):
        assert str(folder / name) in told
        assert (folder / name).exists()
    assert f"--set server.tls_certificate={folder / 'server.pem'}" in told
    assert "arm.example, localhost" in told
    for phone in ("iPhone", "Android"):
        assert phone in told


def test_a_second_call_leaves_the_certificate(folder, capsys):
    cli.main(["certificate"])
    before = (folder / "server.pem").read_bytes()
    capsys.readouterr()
    assert cli.main(["certificate"]) == ExitCode.DONE
    assert "; it stays." in capsys.readouterr().out
    assert (folder / "server.pem").read_bytes() == before


def test_a_wrong_name_is_one_sentence(folder, capsys):
    assert cli.main(["certificate", "--name", "a b"]) == ExitCode.FAILED
    assert capsys.readouterr().err == "armbridge: --name: 'a b' is neither a host name nor an IP address\n"
    assert not folder.exists()


def test_a_token_is_made_once_shown_once_and_kept_for_its_owner_alone(folder, capsys):
    cli.main(["certificate"])
    told = capsys.readouterr().out
    file = folder / "tokens.toml"
    (token,) = re.findall(r"^  ([0-9a-f]{32})$", told, re.MULTILINE)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert f"--set access.token_file={file}" in told
    identity = Tokens.from_settings(AccessSettings(token_file=file)).identify(token)
    assert identity is not None
    assert (identity.name, identity.role) == ("owner", Role.ADMIN)
    kept = file.read_bytes()
    cli.main(["certificate"])
    again = capsys.readouterr().out
    assert token not in again
    assert f"The tokens are in {file}, as before." in again
    assert file.read_bytes() == kept


def test_of_two_commands_at_a_time_one_makes_the_token(folder, monkeypatch):
    def replace_locked(path, content, mode):
        with pytest.raises(FileLockedError):
            FileLock(path).acquire(0.0)
        replace(path, content, mode)

    folder.mkdir(parents=True)
    monkeypatch.setattr(certificate, "replace", replace_locked)
    assert [bool(ensure_token(folder)[1]) for _ in range(2)] == [True, False]


def test_a_token_that_cannot_be_kept_is_one_sentence(folder):
    folder.mkdir(parents=True)
    (folder / "none").touch()
    with pytest.raises(ConfigurationError, match=r"tokens\.toml: the token cannot be kept there"):
        ensure_token(folder / "none")


def test_the_page_about_phones_shows_the_command_that_is_printed(folder, capsys):
    cli.main(["certificate"])
    told = capsys.readouterr().out
    shown = (ROOT / "docs" / "page.md").read_text().replace("/home/me/.local/share/armbridge/tls", str(folder))
    command = told[told.index("  armbridge serve") :].split("\nA server")[0]
    assert "\n".join(line[2:] for line in command.splitlines()) in shown.replace("\n    --", "\n  --")
