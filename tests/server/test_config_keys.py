import re
import tomllib
from pathlib import Path

import pytest

from server.config import Settings
from server.config_keys import every_setting, nearest, template, toml_value
from server.config_loader import known_keys, load, load_with_sources
from server.errors import ConfigurationError
from server.execution.goal import GoalPolicy

SETTINGS = {setting.key: setting for setting in every_setting(Settings)}


def test_every_setting_has_a_meaning_and_a_choice_its_values() -> None:
    assert [key for key, setting in SETTINGS.items() if not setting.meaning] == []
    assert SETTINGS["goals.policy"].range == "queue, reject, preempt"
    assert SETTINGS["goals.on_disconnect"].range == "finish, stop"
    assert SETTINGS["goals.confirm"].range == ""


def test_defaults_do_not_depend_on_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "none")
    assert {setting.key: setting for setting in every_setting(Settings)} == SETTINGS


MEANT = {
    "moveit.plannr_id": "moveit.planner_id",
    "servr.port": "server.port",
    "port": "server.port",
    "goals.port": "server.port",
    "serve": "server",
    "moveit.servo.linear_scales": "moveit.servo.linear_scale",
    "colour": "",
    "some.other.place.altogether.capacty": "goals.capacity",
    "x" * 100_000: "",
}


def test_the_nearest_key_is_the_one_that_was_meant() -> None:
    assert {written: nearest(written, known_keys()) for written in MEANT} == MEANT


TEXT = template(Settings)


def test_the_template_loads_to_the_defaults_and_has_every_setting_in_its_section_explained(tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    file.write_text(TEXT)
    settings, sources = load_with_sources(file, {})
    assert settings.model_dump() == load(None, {}).model_dump()
    assert set(sources.values()) == {"file"}
    for setting in every_setting(Settings):
        # What stands in no section comes before the first.
        heading = f"[{setting.section}]\n" if setting.section else ""
        section = TEXT.partition(heading)[2].partition("\n[")[0] if heading else TEXT.partition("\n[")[0]
        assert re.search(rf"^# .*\n(# )?{setting.name} = ", section, re.MULTILINE), setting.key
    assert '; leave it out for the simulated arm.\n# serial = "..."\n' in TEXT
    assert "\n# limit_mb = ...\n" in TEXT


def test_a_value_is_written_as_toml_reads_it() -> None:
    for value in ('a "b"', 0.5, True, [1, 2], {"a b": 0.5}, {}):
        assert tomllib.loads(f"value = {toml_value(value)}")["value"] == value


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "armbridge.toml"


def test_the_environment_overrides_the_file_and_options_both_and_the_source_of_each_setting_is_known(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = '[server]\nhost = "file"\nport = 1\nlog_level = "error"\n[goals]\npolicy = "preempt"\n'
    file.write_text(f"{text}[arm.zero_offset_rad]\nelbow_flex = 0.1\n")
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    monkeypatch.setenv("ARMBRIDGE_SERVER__LOG_LEVEL", "debug")
    monkeypatch.setenv("ARMBRIDGE_SERVER__TCP_ROS_VERSION", "2")
    settings, sources = load_with_sources(file, {"server": {"log_level": "info"}})
    assert (settings.server.host, settings.server.port, settings.server.log_level) == ("file", 2, "info")
    assert settings.server.tcp_ros_version == 2
    assert settings.goals.policy is GoalPolicy.PREEMPT
    of_file = dict.fromkeys(("server.host", "goals.policy", "arm.zero_offset_rad"), "file")
    of_environment = dict.fromkeys(("server.port", "server.tcp_ros_version"), "environment")
    assert sources == {**of_file, **of_environment, "server.log_level": "command line"}


REFUSED = {
    "[server]\nprt = 1": r"server\.prt: unknown; did you mean port\?",
    "[serve]\nport = 1": r"serve: unknown; did you mean server\?",
    "[moveit]\nmax_velocity_scaling = 3.0": "moveit.max_velocity_scaling: .*1 .*3.0",
    '[moveit]\nplanner_id = "AORRTC"': "moveit.planner_id: .*RRTConnect.*'AORRTC'",
    "[planning]\nmemory_limit_mb = 100": "planning.memory_limit_mb: .*256.*100",
    '[server]\nport = "many"': "server.port.*'many'",
    '[arm]\nurdf = "a.urdf"': "urdf and srdf must be given together",
    "[arm]\nwatchdog_s = 0.1": "arm.watchdog_s: .*0.3.*0.1",
    "[arm]\nwarn_temperature_c = 66": "must rise in this order, not .66",
    '[access]\ntoken = "abc"': r"^access\.token: must have 16 .*, not 3 \(it is not shown",
    '[arm]\non_exit = "fall"': "arm.on_exit.*'fall'",
    "server: port": "not TOML",
    "server = 3": r"server: must be a table, as in \{ name = value \} \(it is 3",
    '[access]\ntopics_glob = "/arm/*"': r'topics_glob: must be a list, as in \["first", "second"\]',
    "[arm]\nzero_offset_rad = 0.02": "zero_offset_rad: must be a table, as in",
    "[arm]\nserial = 3": "arm.serial: must be a text, in quotes",
    "[arms.left]\nbase_xyz_m = [0, 0.2]": r"arms.left.base_xyz_m.2: is missing \(it is \[0, 0.2\]",
}


def test_every_wrong_setting_is_named_once_with_its_limit_and_value_and_no_token(file: Path) -> None:
    for text, words in REFUSED.items():
        file.write_text(text)
        with pytest.raises(ConfigurationError, match=words):
            load(file, {})
    file.write_text('[server]\nport = -1\nmax_clients = 0\n[access]\ntoken = "abc"\n')
    with pytest.raises(ConfigurationError) as refused:
        load(file, {"server": {"port": 1}, "access": {"token": "x" * 32}})
    told = str(refused.value)
    assert told.count("server.port") == told.count("server.max_clients") == 1
    assert "abc" not in told
    assert "it is not shown, from the file" in told


def test_a_byte_order_mark_as_of_editors_of_windows_is_no_mistake(file: Path) -> None:
    file.write_text("\ufeff[server]\nport = 1\n")
    assert load(file, {}).server.port == 1


FROM = ", from the file /.*armbridge\\.toml"
OVERRIDDEN = {
    "[server]\nport = 70000": rf"^server\.port: .*65535 \(it is 70000{FROM}\)$",
    '[server]\nport = "many"': rf"^server\.port: .*'many'{FROM}",
    "server = 3": rf"^server: .*it is 3{FROM}",
}


def test_a_wrong_value_is_refused_also_where_it_is_overridden(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text, words in OVERRIDDEN.items():
        file.write_text(text)
        with pytest.raises(ConfigurationError, match=words):
            load(file, {"server": {"port": 1}})
    file.write_text("[server]\nport = -1\n")
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    with pytest.raises(ConfigurationError, match=r"server\.port: .*-1, from the file"):
        load(file, {})
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "many")
    with pytest.raises(ConfigurationError, match=r"server\.port: .*'many', from the environment"):
        load(None, {"server": {"port": 1}})


def test_the_command_line_may_put_right_what_the_file_leaves_contradictory(file: Path) -> None:
    file.write_text("[arm.guards]\nsettle_timeout_s = 5.0\n[moveit]\nallowed_goal_duration_margin = 1.0\n")
    words = r"arm.guards.settle_timeout_s must be below moveit.allowed_goal_duration_margin, 5 s is not below 1 s"
    with pytest.raises(ConfigurationError, match=words):
        load(file, {})
    assert load(file, {"arm": {"guards": {"settle_timeout_s": 0.5}}}).moveit.allowed_goal_duration_margin == 1.0


STRAY = {
    "ARMBRIDGE_SERVR__PORT": "ARMBRIDGE_SERVR__PORT: unknown; did you mean ARMBRIDGE_SERVER__PORT?",
    "ARMBRIDGE_PORT": "ARMBRIDGE_PORT: unknown; did you mean ARMBRIDGE_SERVER__PORT?",
    "armbridge_colour": "ARMBRIDGE_COLOUR: unknown",
}


def test_a_variable_names_an_entry_or_holds_json_or_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, sentence in STRAY.items():
        with monkeypatch.context() as patched:
            patched.setenv(name, "1")
            with pytest.raises(ConfigurationError) as refused:
                load(None, {})
        assert str(refused.value) == f"environment variable {sentence}"
    monkeypatch.setenv("ARMBRIDGE_ARM__ZERO_OFFSET_RAD__ELBOW_FLEX", "0.1")
    assert load(None, {}).arm.zero_offset_rad == {"elbow_flex": 0.1}
    monkeypatch.setenv("ARMBRIDGE_SERVER", "port")
    with pytest.raises(ConfigurationError, match="environment variable ARMBRIDGE_SERVER: must be JSON"):
        load(None, {})
    monkeypatch.delenv("ARMBRIDGE_SERVER")
    monkeypatch.setenv("ARMBRIDGE_ACCESS__ALLOWED_HOSTS", "lab-pc")
    with pytest.raises(ConfigurationError, match="ACCESS__ALLOWED_HOSTS: must be JSON, a list as in") as refused:
        load(None, {})
    assert "lab-pc" not in str(refused.value)
