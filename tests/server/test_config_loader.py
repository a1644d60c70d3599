from __future__ import annotations

from pathlib import Path

import pytest

from server.config_loader import load, load_with_sources
from server.errors import ConfigurationError
from server.execution.goal import GoalPolicy


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "armbridge.toml"


def test_the_environment_overrides_the_file_and_the_command_line_both(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text('[server]\nhost = "file"\nport = 1\nlog_level = "error"\n[goals]\npolicy = "preempt"\n')
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    monkeypatch.setenv("ARMBRIDGE_SERVER__LOG_LEVEL", "debug")
    monkeypatch.setenv("ARMBRIDGE_SERVER__TCP_ROS_VERSION", "2")
    settings = load(file, {"server": {"log_level": "info"}})
    assert (settings.server.host, settings.server.port, settings.server.log_level) == ("file", 2, "info")
    assert settings.server.tcp_ros_version == 2
    assert settings.goals.policy is GoalPolicy.PREEMPT


REFUSED = {
    "unknown key": ("[server]\nprt = 1", r"server\.prt: unknown; did you mean port\?"),
    "unknown section": ("[serve]\nport = 1", r"serve: unknown; did you mean server\?"),
    "out of range": ("[moveit]\nmax_velocity_scaling = 3.0", "moveit.max_velocity_scaling: .*1 .*3.0"),
    "unknown search": ('[moveit]\nplanner_id = "AORRTC"', "moveit.planner_id: .*RRTConnect.*'AORRTC'"),
    "too little memory": ("[planning]\nmemory_limit_mb = 100", "planning.memory_limit_mb: .*256.*100"),
    "wrong type": ('[server]\nport = "many"', "server.port.*'many'"),
    "urdf alone": ('[arm]\nurdf = "a.urdf"', "urdf and srdf must be given together"),
    "watchdog": ("[arm]\nwatchdog_s = 0.1", "arm.watchdog_s: .*0.3.*0.1"),
    "temperatures": ("[arm]\nwarn_temperature_c = 66", "must rise in this order, not .66"),
    "short token": ('[access]\ntoken = "abc"', r"^access\.token: must have 16 .*, not 3 \(it is not shown"),
    "end state": ('[arm]\non_exit = "fall"', "arm.on_exit.*'fall'"),
    "files to keep": ("[recording]\nkeep_files = 3", "recording: .*keep_files needs limit_mb.* not 3"),
    "no TOML": ("server: port", "not TOML"),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_a_wrong_setting_is_named_with_its_limit_and_value(file: Path, text: str, words: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        load(file, {})


def test_a_file_that_does_not_exist_is_named(file: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"armbridge.toml cannot be read"):
        load(file, {})


def test_the_source_of_each_setting_is_known(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[server]\nport = 1\n[arm.zero_offset_rad]\nelbow_flex = 0.1\n")
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    _, sources = load_with_sources(file, {"goals": {"capacity": 3}})
    assert sources == {"server.port": "environment", "arm.zero_offset_rad": "file", "goals.capacity": "command line"}


OVERRIDDEN = {
    "out of range": (
        "[server]\nport = 70000",
        r"^server\.port: .*65535 \(it is 70000, from the file /.*armbridge\.toml\)$",
    ),
    "wrong type": ('[server]\nport = "many"', r"^server\.port: .*'many', from the file /.*armbridge\.toml"),
    "no section": ("server = 3", r"^server: .*it is 3, from the file /.*armbridge\.toml"),
}


@pytest.mark.parametrize(("text", "words"), OVERRIDDEN.values(), ids=OVERRIDDEN.keys())
def test_a_wrong_value_in_the_file_is_refused_also_where_the_command_line_overrides_it(
    file: Path, text: str, words: str
) -> None:
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        load(file, {"server": {"port": 1}})


def test_a_wrong_value_in_the_file_is_refused_also_where_the_environment_overrides_it(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text("[server]\nport = -1\n")
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    with pytest.raises(ConfigurationError, match=r"server\.port: .*-1, from the file"):
        load(file, {})


def test_a_wrong_value_in_the_environment_is_refused_also_where_the_command_line_overrides_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "many")
    with pytest.raises(ConfigurationError, match=r"server\.port: .*'many', from the environment"):
        load(None, {"server": {"port": 1}})


def test_every_wrong_value_in_the_file_is_told_once(file: Path) -> None:
    file.write_text("[server]\nport = -1\nmax_clients = 0\n")
    with pytest.raises(ConfigurationError) as refused:
        load(file, {"server": {"port": 1}})
    assert str(refused.value).count("server.port") == str(refused.value).count("server.max_clients") == 1


def test_the_command_line_may_put_right_what_the_file_leaves_contradictory(file: Path) -> None:
    file.write_text("[arm.guards]\nsettle_timeout_s = 5.0\n[moveit]\nallowed_goal_duration_margin = 1.0\n")
    with pytest.raises(ConfigurationError, match="must be below"):
        load(file, {})
    assert load(file, {"arm": {"guards": {"settle_timeout_s": 0.5}}}).moveit.allowed_goal_duration_margin == 1.0


def test_an_overridden_token_of_the_file_is_not_shown(file: Path) -> None:
    file.write_text('[access]\ntoken = "abc"\n')
    with pytest.raises(ConfigurationError) as refused:
        load(file, {"access": {"token": "x" * 32}})
    assert "abc" not in str(refused.value)
    assert "it is not shown, from the file" in str(refused.value)


STRAY = {
    "ARMBRIDGE_SERVR__PORT": "ARMBRIDGE_SERVR__PORT: unknown; did you mean ARMBRIDGE_SERVER__PORT?",
    "ARMBRIDGE_PORT": "ARMBRIDGE_PORT: unknown; did you mean ARMBRIDGE_SERVER__PORT?",
    "armbridge_colour": "ARMBRIDGE_COLOUR: unknown",
}


@pytest.mark.parametrize(("name", "sentence"), STRAY.items(), ids=STRAY.keys())
def test_a_variable_that_sets_nothing_is_refused(name: str, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "1")
    with pytest.raises(ConfigurationError) as refused:
        load(None, {})
    assert str(refused.value) == f"environment variable {sentence}"


def test_a_variable_may_name_an_entry_of_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_ARM__ZERO_OFFSET_RAD__ELBOW_FLEX", "0.1")
    assert load(None, {}).arm.zero_offset_rad == {"elbow_flex": 0.1}


def test_a_variable_of_a_section_that_is_no_json_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_SERVER", "port")
    with pytest.raises(ConfigurationError, match=r'environment: .*"server"'):
        load(None, {})
