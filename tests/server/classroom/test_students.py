import csv
import stat
from pathlib import Path

import pytest

from server.classroom.students import LIST_FILE, TEACHER, new_token, places, reachable_name, read_tokens, write_list
from server.config import RecordingSettings, Settings
from server.errors import ConfigurationError, StartError

TOKEN = "t" * 24
HOST = "127.0.0.1"


def test_ports_follow_the_first_and_end_where_ports_end(tmp_path: Path) -> None:
    assert [student.port for student in places(3, 9100, tmp_path, HOST)] == [9100, 9101, 9102]
    students = places(20, 0, tmp_path, HOST)
    assert len({student.port for student in students}) == len({student.token for student in students}) == 20
    with pytest.raises(ConfigurationError, match="65530 to 65539, there are none above 65535"):
        places(10, 65_530, tmp_path, HOST)


def test_tokens_of_the_list_stay_and_new_students_get_new_ones(tmp_path: Path) -> None:
    before = places(2, 9100, tmp_path, HOST)
    write_list(tmp_path / LIST_FILE, before, TOKEN, HOST, tls=False)
    after = places(3, 9200, tmp_path, HOST)
    assert [student.token for student in after[:2]] == [student.token for student in before]
    assert after[2].token not in {student.token for student in before}
    assert read_tokens(tmp_path / LIST_FILE)[TEACHER] == TOKEN


def test_the_list_has_a_line_for_each_with_name_address_and_token(tmp_path: Path) -> None:
    students = places(2, 9100, tmp_path, HOST)
    write_list(tmp_path / LIST_FILE, students, TOKEN, HOST, tls=True)
    with (tmp_path / LIST_FILE).open(newline="") as lines:
        rows = list(csv.reader(lines))
    # Lines as awk and cut take them, too.
    assert b"\r" not in (tmp_path / LIST_FILE).read_bytes()
    assert rows[0] == ["name", "url", "token"]
    assert rows[1] == ["student01", "wss://127.0.0.1:9100", students[0].token]
    assert rows[-1] == ["teacher", "wss://127.0.0.1:9100", TOKEN]
    assert stat.S_IMODE((tmp_path / LIST_FILE).stat().st_mode) == 0o600


@pytest.mark.parametrize("text", ["name,url\nstudent01,ws://x\n", "name,url,token\nstudent01,ws://x,short\n"])
def test_a_file_that_is_no_such_list_is_refused_and_left_alone(tmp_path: Path, text: str) -> None:
    (tmp_path / LIST_FILE).write_text("")
    assert read_tokens(tmp_path / LIST_FILE) == {}
    (tmp_path / LIST_FILE).write_text(text)
    with pytest.raises(StartError, match="is no list of students"):
        places(1, 9100, tmp_path, HOST)
    assert (tmp_path / LIST_FILE).read_text() == text


def test_what_a_server_keeps_is_in_the_students_folder(tmp_path: Path) -> None:
    (student,) = places(1, 9100, tmp_path, HOST)
    settings = student.settings(
        Settings(recording=RecordingSettings(file=Path("runs/lesson.mcap"))),
        TOKEN,
        {"student01": 9100, "student02": 9101},
    )
    kept = (settings.scene.file, settings.goals.named_states_file, settings.recording.file)
    assert [file.parent for file in kept if file is not None] == [tmp_path / "student01"] * 3
    assert settings.server.port == 9100
    assert settings.server.classroom == {"student01": 9100, "student02": 9101}


def test_a_token_of_the_same_name_in_the_settings_is_refused(tmp_path: Path) -> None:
    (student,) = places(1, 9100, tmp_path, HOST)
    settings = Settings.model_validate({"access": {"operate_tokens": {"student01": new_token()}}})
    with pytest.raises(ConfigurationError, match="student01"):
        student.settings(settings, TOKEN, {})


def test_an_address_that_stands_for_all_is_shown_by_the_name_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "lab")
    shown = [reachable_name(host) for host in ("0.0.0.0", "::", "10.0.0.2", "::1", "lab.example.org")]
    assert shown == ["lab", "lab", "10.0.0.2", "[::1]", "lab.example.org"]
