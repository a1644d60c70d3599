from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from server.config import Settings
from server.config_keys import every_setting
from server.config_reading import load, load_with_sources
from server.config_template import template, toml_value

TEXT = template(every_setting(Settings))


def test_the_template_loads_to_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    file.write_text(TEXT)
    settings, sources = load_with_sources(file, {})
    assert settings.model_dump() == load(None, {}).model_dump()
    assert set(sources.values()) == {"file"}


@pytest.mark.parametrize("setting", list(every_setting(Settings)), ids=lambda setting: setting.key)
def test_every_setting_stands_in_its_section_below_its_explanation(setting) -> None:
    section = TEXT.partition(f"[{setting.section}]\n")[2].partition("\n[")[0]
    assert re.search(rf"^# .*\n(# )?{setting.name} = ", section, re.MULTILINE)


def test_an_explanation_ends_with_unit_and_range() -> None:
    assert "# Rate of /joint_states. (Hz, at least 1, at most 100)\njoint_state_rate_hz = 50.0\n" in TEXT


def test_what_has_no_default_is_left_out_and_says_what_that_means() -> None:
    assert '# Serial device, URL or auto; leave it out for the simulated arm.\n# serial = "..."\n' in TEXT
    assert "\n# limit_mb = ...\n" in TEXT


VALUES = {"text": 'a "b"', "number": 0.5, "switch": True, "list": [1, 2], "table": {"a b": 0.5}, "empty": {}}


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES.keys())
def test_a_value_is_written_as_toml_reads_it(value) -> None:
    assert tomllib.loads(f"value = {toml_value(value)}")["value"] == value
