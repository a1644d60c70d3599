from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from server.config import Settings
from server.config_keys import every_setting, nearest, template, toml_value
from server.config_loader import known_keys, load, load_with_sources

SETTINGS = {setting.key: setting for setting in every_setting(Settings)}


def test_every_setting_says_what_it_means() -> None:
    assert [key for key, setting in SETTINGS.items() if not setting.meaning] == []


def test_the_range_of_a_choice_is_its_values() -> None:
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


@pytest.mark.parametrize(("written", "meant"), MEANT.items(), ids=[key[:40] for key in MEANT])
def test_the_nearest_key_is_the_one_that_was_meant(written: str, meant: str) -> None:
    assert nearest(written, known_keys()) == meant


TEXT = template(Settings)


def test_the_template_loads_to_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    file.write_text(TEXT)
    settings, sources = load_with_sources(file, {})
    assert settings.model_dump() == load(None, {}).model_dump()
    assert set(sources.values()) == {"file"}


def test_every_setting_stands_in_its_section_below_its_explanation() -> None:
    for setting in every_setting(Settings):
        # What stands in no section comes before the first.
        heading = f"[{setting.section}]\n" if setting.section else ""
        section = TEXT.partition(heading)[2].partition("\n[")[0] if heading else TEXT.partition("\n[")[0]
        assert re.search(rf"^# .*\n(# )?{setting.name} = ", section, re.MULTILINE), setting.key


def test_a_setting_without_default_is_commented_out_with_its_meaning() -> None:
    assert '; leave it out for the simulated arm.\n# serial = "..."\n' in TEXT
    assert "\n# limit_mb = ...\n" in TEXT


VALUES = {"text": 'a "b"', "number": 0.5, "switch": True, "list": [1, 2], "table": {"a b": 0.5}, "empty": {}}


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES.keys())
def test_a_value_is_written_as_toml_reads_it(value) -> None:
    assert tomllib.loads(f"value = {toml_value(value)}")["value"] == value
