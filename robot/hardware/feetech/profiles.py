"""Profiles of servo settings: what the factory, and other programs, leave in the servos, and what a difference means.

lerobot writes its settings each time it connects (configure_motors in its feetech.py, configure in so_follower.py): a
position gain of half the factory's for every joint, and less torque and current for the gripper. So most arms are in
one of two states, and both are well. A register that has neither value is worth a sentence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot.errors import DescriptionError
from robot.hardware.feetech.registers import AMPERE_PER_UNIT, EPROM, Register
from robot.hardware.servos.registers import RETURN_DELAY_UNIT_US

if TYPE_CHECKING:
    from robot.description.robot_file import ProfileTable


@dataclass(frozen=True)
class ServoProfile:
    """Values that the settings of an arm's servos should have."""

    name: str  # its name for people
    registers: Mapping[Register, int]  # value of each register that the profile fixes
    gripper: Mapping[Register, int] = field(default_factory=dict)  # those that are others at the gripper's servo

    def expected(self, *, gripper: bool) -> dict[Register, int]:
        return {**self.registers, **(self.gripper if gripper else {})}

    def differences(self, settings: Mapping[Register, int], *, gripper: bool) -> dict[Register, int]:
        """Return the registers of a servo that have another value, with the expected one."""
        expected = self.expected(gripper=gripper)
        return {register: value for register, value in expected.items() if settings[register] != value}


# Feetech's memory table V3.6.
FACTORY = ServoProfile(
    "factory",
    {
        Register.MAX_TORQUE: 1000,
        Register.P_GAIN: 32,
        Register.D_GAIN: 32,
        Register.I_GAIN: 0,
        Register.PROTECTION_CURRENT: 500,
        Register.PROTECTIVE_TORQUE: 20,
        Register.PROTECTION_TIME: 200,
        Register.OVERLOAD_TORQUE: 80,
    },
)

LEROBOT = ServoProfile(
    "lerobot",
    {**FACTORY.registers, Register.P_GAIN: 16},
    {Register.MAX_TORQUE: 500, Register.PROTECTION_CURRENT: 250, Register.OVERLOAD_TORQUE: 25},
)

PROFILES: Mapping[str, ServoProfile] = {each.name: each for each in (FACTORY, LEROBOT)}

# Meaning of a register that differs from the profile; formatted with its value.
_MEANINGS: Mapping[Register, str] = {
    Register.P_GAIN: "with less gain the joint droops further under load, with more it may oscillate",
    Register.D_GAIN: "with less damping the joint overshoots, with more it hums",
    Register.I_GAIN: "the joint creeps on after it has reached its goal, and may swing",
    Register.MAX_TORQUE: "the servo gives {percent:g} % of its torque at most",
    Register.PROTECTION_CURRENT: "the servo switches off when it draws {ampere:.1f} A for long",
    Register.PROTECTIVE_TORQUE: "after an overload {value} % of its torque are left",
    Register.PROTECTION_TIME: "an overload latches after {seconds:g} s",
    Register.OVERLOAD_TORQUE: "an overload latches when the load stays above {value} %",
    Register.RETURN_DELAY: "every reply comes {delay_us} us later",
}


def profile_of(spec: ProfileTable | None) -> ServoProfile | None:
    """Build the profile of ``[hardware.profile]``; raises DescriptionError for an unknown register or its value."""
    if spec is None:
        return None
    base = PROFILES[spec.base]
    own, gripper = _registers(spec.registers, "registers"), _registers(spec.gripper, "gripper")
    if not own and not gripper:
        return base
    # A register that the arm names for all its servos is meant for the gripper too.
    kept = {register: value for register, value in base.gripper.items() if register not in own}
    return ServoProfile("robot.toml", {**base.registers, **own}, {**kept, **gripper})


def nearest_profile(servos: Iterable[tuple[Mapping[Register, int], bool]]) -> ServoProfile:
    """Return the profile from which an arm's servos differ least; each servo comes with True for the gripper's."""
    held = tuple(servos)
    return min(
        PROFILES.values(),
        key=lambda profile: sum(len(profile.differences(settings, gripper=gripper)) for settings, gripper in held),
    )


def meaning(register: Register, value: int) -> str:
    """Return what a register's value means for the arm, empty for a value that says enough."""
    return _MEANINGS.get(register, "").format(
        value=value,
        percent=value / 10,
        ampere=value * AMPERE_PER_UNIT,
        seconds=value / 100,
        delay_us=value * RETURN_DELAY_UNIT_US,
    )


def _registers(named: Mapping[str, int], key: str) -> dict[Register, int]:
    settings = {register.name: register for register in EPROM}
    found = {}
    for name, value in named.items():
        register = settings.get(name.upper())
        place = f"hardware.profile.{key}.{name}:"
        if register is None:
            raise DescriptionError(place, f"there is no such setting; a servo has {', '.join(settings)}")
        lowest, highest = register.value_range
        if not lowest <= value <= highest:
            raise DescriptionError(place, f"must be {lowest} to {highest}, not {value}")
        found[register] = value
    return found
