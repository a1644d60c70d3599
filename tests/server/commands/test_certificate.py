import re
import stat

import pytest

from harness.server import ROOT
from robot.files import FileLock, FileLockedError, replace
from server import cli
from server.access.authentication import Tokens
from server.access.settings import AccessSettings
from server.commands import certificate
from server.commands.certificate import ensure_token
from server.commands.terminal import ExitCode
from server.errors import ConfigurationError
from server.graph.permissions import Role


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "armbridge" / "tls"


def test_certificate_and_token_are_made_once_and_kept_for_their_owner_who_is_told_what_to_do(folder, capsys):
    tokens = folder / "tokens.toml"
    files = [folder / name for name in ("server.pem", "server.key", "armbridge-authority.crt")] + [tokens]
    assert cli.main(["certificate", "--name", "arm.example"]) == ExitCode.DONE
    told = capsys.readouterr().out
    settings = f"--set server.tls_certificate={files[0]}", f"--set access.token_file={tokens}"
    for words in (*map(str, files), *settings, "arm.example, localhost", "iPhone", "Android"):
        assert words in told
    (token,) = re.findall(r"^  ([0-9a-f]{32})$", told, re.MULTILINE)
    assert stat.S_IMODE(tokens.stat().st_mode) == 0o600
    identity = Tokens.from_settings(AccessSettings(token_file=tokens)).identify(token)
    assert identity is not None
    assert (identity.name, identity.role) == ("owner", Role.ADMIN)
    kept = [file.read_bytes() for file in files]
    assert cli.main(["certificate"]) == ExitCode.DONE
    told = capsys.readouterr().out
    assert "; it stays." in told
    assert f"The tokens are in {tokens}, as before." in told
    assert token not in told
    assert [file.read_bytes() for file in files] == kept


def test_a_wrong_name_is_one_sentence(folder, capsys):
    assert cli.main(["certificate", "--name", "a b"]) == ExitCode.FAILED
    assert capsys.readouterr().err == "armbridge: --name: 'a b' is neither a host name nor an IP address\n"
    assert not folder.exists()


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
