from __future__ import annotations

import pytest

from server import cli
from server.commands.certificate import add_certificate_parser
from server.commands.terminal import ExitCode


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
