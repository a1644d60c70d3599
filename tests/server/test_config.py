from dataclasses import fields

import pytest
from pydantic import BaseModel, ValidationError

from robot.messages import ArmConfig, GuardLimits
from server.config import ArmSettings, GuardSettings
from server.config_loader import load
from server.errors import ConfigurationError
from server.gateway.settings import ServerSettings


def test_a_number_out_of_range_is_refused() -> None:
    for workers, words in (
        (0, "greater than or equal to 1"),
        (17, "less than or equal to 16"),
        ("17", "16"),
        ("-1", "1"),
        ("many", "integer"),
    ):
        with pytest.raises(ConfigurationError, match=f"planning.workers: .*{words}"):
            load(None, {"planning": {"workers": workers}})


def taken(section: type[BaseModel], name: str, value: float) -> bool:
    try:
        section.model_validate({name: value})
    except ValidationError as error:
        return any("must rise" in each["msg"] for each in error.errors())
    return True


def test_every_limit_of_the_guards_is_a_setting_with_its_default() -> None:
    arm, limits = ArmSettings(), vars(GuardLimits())
    assert {name: getattr(arm.guards if name in GuardSettings.model_fields else arm, name) for name in limits} == limits
    assert set(GuardSettings.model_fields) < set(limits)


GUARD_RANGES, CONFIG_RANGES = (
    {each.name: each.metadata["range"] for each in fields(part) if each.metadata} for part in (GuardLimits, ArmConfig)
)
RANGES = [
    *(
        (GuardSettings if name in GuardSettings.model_fields else ArmSettings, name, bounds)
        for name, bounds in GUARD_RANGES.items()
    ),
    *((ArmSettings, name, bounds) for name, bounds in CONFIG_RANGES.items() if name != "state_rate_hz"),
    (ArmSettings, "joint_state_rate_hz", CONFIG_RANGES["state_rate_hz"]),
]


@pytest.mark.parametrize(("section", "name", "bounds"), RANGES, ids=[name for _, name, _ in RANGES])
def test_the_range_is_that_of_the_arm_process(section: type[BaseModel], name: str, bounds: tuple[float, float]) -> None:
    assert all(taken(section, name, value) for value in bounds)
    assert not any(taken(section, name, value) for value in (bounds[0] - 0.001, bounds[1] + 0.001, float("nan")))


@pytest.mark.parametrize(("given", "missing"), [("tls_key", "tls_certificate"), ("tls_certificate", "tls_key")])
def test_a_certificate_needs_its_key_and_the_other_way_round(given: str, missing: str) -> None:
    with pytest.raises(ValidationError, match=f"must be given together; {missing} is missing"):
        ServerSettings.model_validate({given: "x.pem"})


def refusal_of(**arms: dict[str, object]) -> str:
    with pytest.raises(ConfigurationError) as refused:
        load(None, {"arms": arms})
    return str(refused.value)


REFUSED_ARMS: list[tuple[dict[str, dict[str, object]], str]] = [
    *(
        ({name: {}}, "the name of an arm must be a to z, 0 to 9 and _")
        for name in ("Left", "2nd", "le ft", "", "a" * 40, "le/ft")
    ),
    *(
        ({name: {}}, f"an arm cannot have the name {name!r}")
        for name in ("arm", "moveit", "rosapi", "servo_node", "teleop", "world")
    ),
    ({"left": {"serial": "auto"}, "right": {}}, "name each"),
    ({"left": {}, "left_2": {}}, "arms.left_2: begins as names of arms.left do"),
    ({"left": {"seriel": "/dev/x"}}, "arms.left.seriel: unknown; did you mean serial?"),
    ({f"a{number:02}": {} for number in range(33)}, "there are 33 arms, the limit is 32"),
    ({"left": {"guards": {"settle_timeout_s": 5.0}}}, "arms.left.guards.settle_timeout_s must be below"),
]


def test_arms_that_cannot_be_together_are_refused(tmp_path) -> None:
    for arms, words in REFUSED_ARMS:
        assert words in refusal_of(**arms)
    port, alias = tmp_path / "ttyACM0", tmp_path / "by-id"
    port.touch()
    alias.symlink_to(port)
    said = refusal_of(left={"serial": str(port)}, right={"serial": str(alias)})
    assert said.startswith(f"settings: arms.right.serial: {alias} is the port of arms.left already")
    with pytest.raises(ConfigurationError, match="each has its settings in its own section"):
        load(None, {"arm": {"robot": "so101"}, "arms": {"left": {}}})


def test_arms_come_from_the_environment_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_ARMS__LEFT__START_ENABLED", "false")
    monkeypatch.setenv("ARMBRIDGE_ARMS__LEFT__BASE_XYZ_M", "[0.0, 0.2, 0.0]")
    left = load(None, {}).arms["left"]
    assert (left.start_enabled, left.base_xyz_m) == (False, (0.0, 0.2, 0.0))
