from __future__ import annotations

from pathlib import Path

import pytest

from server.config import load
from server.errors import ConfigurationError
from server.goal_queue import GoalPolicy


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "armbridge.toml"


def test_the_defaults_are_those_of_the_old_goal_node() -> None:
    moveit = load(None, {}).moveit
    assert (moveit.group_name, moveit.num_planning_attempts, moveit.allowed_planning_time) == ("arm", 5, 5.0)
    assert (moveit.max_velocity_scaling, moveit.max_acceleration_scaling) == (0.3, 0.3)
    assert (moveit.position_tolerance, moveit.joint_tolerance) == (0.01, 0.01)


def test_the_environment_overrides_the_file_and_the_command_line_both(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text('[server]\nhost = "file"\nport = 1\nlog_level = "error"\n[goals]\npolicy = "preempt"\n')
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    monkeypatch.setenv("ARMBRIDGE_SERVER__LOG_LEVEL", "debug")
    settings = load(file, {"server": {"log_level": "info"}})
    assert (settings.server.host, settings.server.port, settings.server.log_level) == ("file", 2, "info")
    assert settings.goals.policy is GoalPolicy.PREEMPT


REFUSED = {
    "unknown key": ("[server]\nprt = 1", "server.prt"),
    "unknown section": ("[serve]\nport = 1", "serve"),
    "out of range": ("[moveit]\nmax_velocity_scaling = 3.0", "moveit.max_velocity_scaling: .*1 .*3.0"),
    "unknown search": ('[moveit]\nplanner_id = "AORRTC"', "moveit.planner_id: .*RRTConnect.*'AORRTC'"),
    "too little memory": ("[planning]\nmemory_limit_mb = 100", "planning.memory_limit_mb: .*256.*100"),
    "wrong type": ('[server]\nport = "many"', "server.port.*'many'"),
    "urdf alone": ('[arm]\nurdf = "a.urdf"', "urdf and srdf must be given together"),
    "watchdog": ("[arm]\nwatchdog_s = 0.1", "arm.watchdog_s: .*0.3.*0.1"),
    "temperatures": ("[arm]\nwarn_temperature_c = 66", "must rise in this order, not .66"),
    "end state": ('[arm]\non_exit = "fall"', "arm.on_exit.*'fall'"),
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
