"""The speed of an arm on servos until its calibration is verified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robot.messages import ChangePace, Pace
from server.arm.arms import ServedArm
from server.arm.verifying import FirstMotions
from server.config import ArmSettings
from tests.helpers.fake_arm import FakeArm

CAP = 0.25


class Served:
    """An arm with a calibration, as one server after the other has it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = folder / "arm.json"
        self.calibration.write_text("{}")

    def start(self, **settings: Any) -> tuple[FakeArm, FirstMotions]:
        arm = FakeArm()
        description: Any = SimpleNamespace(calibration_file=self.calibration)
        own = ArmSettings(**{"serial": "/dev/ttyACM0", **settings})
        first_motions = FirstMotions(ServedArm("", own, description, arm.as_arm), self.folder / "verified")
        first_motions.begin()
        return arm, first_motions

    @staticmethod
    def limit(arm: FakeArm, share: float) -> None:
        """Have the arm say that this is its limit."""
        arm.state = replace(arm.state, pace=Pace(speed_limit=share))


@pytest.fixture
def served(tmp_path: Path) -> Served:
    return Served(tmp_path)


def test_an_arm_that_is_not_verified_moves_slowly_and_says_so(served: Served) -> None:
    arm, first_motions = served.start()
    assert arm.changes == [ChangePace(speed_limit=CAP)]
    assert "not verified yet: no joint moves faster than 25%" in first_motions.advice


@pytest.mark.parametrize(
    "settings", [{"serial": None}, {"unverified_speed_limit": 1.0}, {"speed_limit": 0.1}], ids=repr
)
def test_nothing_is_limited_without_servos_or_where_the_settings_say_so(served: Served, settings: Any) -> None:
    arm, first_motions = served.start(**settings)
    assert (arm.changes, first_motions.advice) == ([], "")


def test_a_verified_arm_moves_at_its_own_speed_also_after_a_restart(served: Served) -> None:
    arm, first_motions = served.start(speed_limit=0.8)
    served.limit(arm, CAP)
    first_motions.take_verified()
    assert arm.changes[-1] == ChangePace(speed_limit=0.8)
    assert served.start()[0].changes == []


def test_a_new_calibration_or_trim_is_to_be_verified_again(served: Served) -> None:
    served.start()[1].take_verified()
    assert served.start(zero_offset_rad={"elbow_flex": 0.05})[1].advice
    served.calibration.write_text('{"other": 1}')
    assert served.start()[1].advice


def test_a_speed_limit_that_a_client_chose_stays_after_the_verification(served: Served) -> None:
    arm, first_motions = served.start()
    served.limit(arm, 0.1)
    first_motions.take_verified()
    assert arm.changes == [ChangePace(speed_limit=CAP)]
