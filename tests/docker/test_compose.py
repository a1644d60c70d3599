"""What compose starts; the engine itself is not needed to read it."""

import re
from typing import Any

import pytest
import yaml

from harness.server import ROOT

TEXT = (ROOT / "docker/compose.yaml").read_text()
SERVICES: dict[str, Any] = yaml.safe_load(TEXT)["services"]


@pytest.mark.parametrize("name", ["simulated", "real"])
def test_a_server_has_no_more_rights_than_it_needs_and_is_open_to_its_own_machine_alone(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert not {"privileged", "cap_add", "network_mode", "pid", "user"} & service.keys()
    assert service["mem_limit"]
    assert service["pids_limit"]
    assert service["ports"] == ["${ARMBRIDGE_PUBLISH:-127.0.0.1:9090}:9090"]


def test_only_the_simulated_arm_is_started_unless_told_otherwise() -> None:
    assert [name for name, service in SERVICES.items() if "profiles" not in service] == ["simulated"]
    assert "devices" not in SERVICES["simulated"]


def test_the_real_arm_is_not_served_without_a_token() -> None:
    assert "--insecure" not in SERVICES["real"]["command"]
    assert "ARMBRIDGE_ACCESS__TOKEN" in SERVICES["real"]["environment"]


def test_nobody_who_wants_the_simulated_arm_is_asked_for_the_token_of_the_real_one() -> None:
    assert re.findall(r"\$\{\w+:?\?", TEXT) == []


def test_the_real_arm_is_the_device_that_is_handed_in() -> None:
    real = SERVICES["real"]
    (device,) = real["devices"]
    assert device.rpartition(":")[2] == real["command"][real["command"].index("--serial") + 1]
