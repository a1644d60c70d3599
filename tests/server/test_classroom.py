"""A classroom and its students."""

import stat
from pathlib import Path

import pytest

from harness.server import free_ports
from robot import files
from server.classroom import (
    LIST_FILE,
    TEACHER,
    new_token,
    places,
    reachable_name,
    read_tokens,
    run_classroom,
    write_list,
)
from server.config import Settings
from server.errors import ConfigurationError, StartError


def test_a_bad_classroom_is_refused_before_it_is_made(tmp_path: Path) -> None:
    for settings, physics, sentence in (
        ({"arm": {"serial": "/dev/ttyACM0"}}, [], "arm.serial: the arms of a classroom are simulated"),
        ({"emulator": {"control": "/tmp/servos"}}, [], "emulator.control: the arms of a classroom are simulated"),
        ({"emulator": {"write_log": "/tmp/writes"}}, [], "emulator.write_log: the arms of a classroom are simulated"),
        ({"zenoh": {"mode": "peer"}}, [], "zenoh.mode: must be off in a classroom, not peer"),
        ({"server": {"tcp_port": 9091}}, [], "server.tcp_port: the servers of a classroom have one port each"),
        ({"arm": {"robot": "no such arm"}}, [], "no such arm"),
        (
            {"server": {"port": 65_535}},
            [],
            "--port: 2 students need ports in a row, 65535 to 65536: there are 1 to 65535",
        ),
        ({}, ["student01", "student03"], "--physics: there is no 'student03': the students are student01 to student02"),
    ):
        folder = tmp_path / "class"
        with pytest.raises(ConfigurationError, match=sentence):
            run_classroom(Settings.model_validate(settings), 2, 2, folder, physics)
        assert not folder.exists(), settings


def test_students_by_name_have_physics_and_the_others_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[str] = []
    module = "server.classroom"
    monkeypatch.setattr(f"{module}.serve", lambda settings, *_: served.append(settings.simulation.kind))
    monkeypatch.setattr(f"{module}.supervise", lambda members: [member.run() for member in members[1:]])
    run_classroom(Settings.model_validate({"server": {"port": free_ports(3)}}), 3, 2, tmp_path, ["student02"])
    assert served == ["light", "physics", "light"]


def test_a_second_classroom_leaves_the_folder_of_a_running_one_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.classroom.supervise", lambda _members: None)
    settings = Settings.model_validate({"server": {"port": free_ports(3)}})
    with files.locked(tmp_path / LIST_FILE), pytest.raises(files.FileLockedError, match="is in use by armbridge"):
        run_classroom(settings, 3, 2, tmp_path, [])
    assert not (tmp_path / LIST_FILE).exists()


TOKEN = "t" * 24
HOST = "127.0.0.1"


def test_ports_follow_the_first_and_end_where_ports_end(tmp_path: Path) -> None:
    assert [student.port for student in places(3, 9100, tmp_path)] == [9100, 9101, 9102]
    assert len({student.token for student in places(20, 9100, tmp_path)}) == 20
    for first, ports in ((65_530, "65530 to 65539"), (0, "0 to 9")):
        with pytest.raises(ConfigurationError, match=f"{ports}: there are 1 to 65535"):
            places(10, first, tmp_path)


def test_the_list_has_name_address_and_token_of_each_and_tokens_stay_for_the_next_time(tmp_path: Path) -> None:
    file, students = tmp_path / LIST_FILE, places(2, 9100, tmp_path)
    write_list(file, students, TOKEN, HOST, tls=True)
    # Lines as awk and cut take them, too.
    assert file.read_bytes().decode() == (
        f"name,url,token\nstudent01,wss://127.0.0.1:9100,{students[0].token}\n"
        f"student02,wss://127.0.0.1:9101,{students[1].token}\nteacher,wss://127.0.0.1:9100,{TOKEN}\n"
    )
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    after = [student.token for student in places(3, 9200, tmp_path)]
    assert after[:2] == [student.token for student in students]
    assert after[2] not in after[:2]
    assert read_tokens(file)[TEACHER] == TOKEN


@pytest.mark.parametrize("text", ["name,url\nstudent01,ws://x\n", "name,url,token\nstudent01,ws://x,short\n"])
def test_a_file_that_is_no_such_list_is_refused_and_left_alone(tmp_path: Path, text: str) -> None:
    (tmp_path / LIST_FILE).write_text("")
    assert read_tokens(tmp_path / LIST_FILE) == {}
    (tmp_path / LIST_FILE).write_text(text)
    with pytest.raises(StartError, match="is no list of students"):
        places(1, 9100, tmp_path)
    assert (tmp_path / LIST_FILE).read_text() == text


def test_what_a_server_keeps_is_in_the_students_folder_and_tokens_of_their_name_are_refused(tmp_path: Path) -> None:
    (student,) = places(1, 9100, tmp_path)
    ports = {"student01": 9100, "student02": 9101}
    settings = student.settings(Settings.model_validate({"recording": {"file": "runs/lesson.mcap"}}), TOKEN, ports)
    kept = (settings.scene.file, settings.goals.named_states_file, settings.recording.file)
    assert [file.parent for file in kept if file is not None] == [tmp_path / "student01"] * 3
    assert (settings.server.port, settings.server.classroom) == (9100, ports)
    own = Settings.model_validate({"access": {"operate_tokens": {"student01": new_token()}}})
    with pytest.raises(ConfigurationError, match="student01"):
        student.settings(own, TOKEN, {})


def test_an_address_that_stands_for_all_is_shown_by_the_name_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "lab")
    shown = [reachable_name(host) for host in ("0.0.0.0", "::", "10.0.0.2", "::1", "lab.example.org")]
    assert shown == ["lab", "lab", "10.0.0.2", "[::1]", "lab.example.org"]
