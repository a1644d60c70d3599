"""The page with another arm: a lift and six joints that turn, two groups, and a gripper of two fingers."""

import functools
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from harness.clients import tip
from harness.page import SHARED, OpenPage, opened
from harness.server import FAST_ARMS, ROOT, RunningServer
from tests.helpers.arm_record import hold_until
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.page.test_drive import hold
from tests.page.test_page import set_speed

JOINTS = ["lift", "a2", "a3", "a4", "a5", "a6", "a7"]
# Panels in which every joint of the group is named.
PANELS_WITH_JOINTS = ("move", "drive", "plots")

# The servos of an ideal arm are exact; what remains is the last tick.
ARRIVED = 0.01

# Servos carry the arm's weight, and have backlash.
ON_SERVOS = 0.06

# Far more than an arm at rest moves.
MOVED_M = 0.1


def finger(side: str, sign: int) -> str:
    return f"""
      <link name="{side}"><visual><geometry><box size="0.01 0.01 0.05"/></geometry></visual></link>
      <joint name="{side}_finger" type="prismatic"><parent link="tool"/><child link="{side}"/><axis xyz="0 {sign} 0"/>
        <limit lower="0" upper="0.05" velocity="0.2" effort="9"/></joint>"""


URDF = re.sub(
    r'"a1" type="revolute"(.*?lower=)"-2.9" upper="2.9" velocity="2"',
    r'"lift" type="prismatic"\1"0" upper="0.4" velocity="0.5"',
    SEVEN_JOINT_URDF,
    flags=re.DOTALL,
).replace("</robot>", f"{finger('left', 1)}{finger('right', -1)}</robot>")
SRDF = SEVEN_JOINT_SRDF.replace('"a1"', '"lift"').replace(
    "</robot>",
    """<group name="fingers"><joint name="left_finger"/><joint name="right_finger"/></group>
    <group name="upper"><chain base_link="pedestal" tip_link="fore"/></group>
    <end_effector name="fingers" parent_link="tool" group="fingers" parent_group="arm"/>
    <group_state name="open" group="fingers">
      <joint name="left_finger" value="0.04"/><joint name="right_finger" value="0.04"/></group_state>
    <disable_collisions link1="left" link2="right"/></robot>""",
)


@pytest.fixture(scope="module")
def settings(settings: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder: Path = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.srdf").write_text(SRDF)
    files = {f"ARMBRIDGE_ARM__{kind.upper()}": str(folder / f"arm.{kind}") for kind in ("urdf", "srdf")}
    return {**settings, **files, **SHARED, **FAST_ARMS}


@pytest.fixture(scope="module")
def page(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser) as open_page:
        open_page.open(server.port)
        open_page.until_state("s.robot !== null && Object.keys(s.limits).length > 0")
        yield open_page


def test_the_joints_of_the_group_are_listed_and_one_that_slides_in_millimetres(page: OpenPage) -> None:
    page.part("joint-a7-number").wait_for()
    assert page.part("joints").locator("b").all_text_contents() == JOINTS
    page.until_text("joint-lift-limits", "400.0")
    page.until_text("joint-lift-measured", "mm")
    page.until_text("joint-a2-measured", "°")


def assert_every_panel_shows(page: OpenPage, joints: list[str]) -> None:
    """Open each panel, and look for all joints in those that list them."""
    for panel in page.open_panels():
        if panel in PANELS_WITH_JOINTS:
            for joint in joints:
                page.until_text(f"panel-{panel}", joint)
    assert page.errors == []
    page.open_panel("move")


def test_every_panel_lists_the_joints_that_the_description_has(page: OpenPage) -> None:
    assert_every_panel_shows(page, JOINTS)


@pytest.fixture(scope="module")
def fetch(settings: dict[str, str]) -> Iterator[RunningServer]:
    """A server with the robot whose lift and arm are eight joints, beside a gripper of two fingers."""
    own = {key: value for key, value in settings.items() if not key.startswith("ARMBRIDGE_ARM__")}
    with RunningServer("--port 0 --robot fetch", own) as running:
        yield running


def test_an_arm_with_a_lift_has_all_panels_and_moves(browser: Browser, fetch: RunningServer) -> None:
    with opened(browser) as page:
        page.open(fetch.port)
        page.until_state("s.robot !== null && Object.keys(s.limits).length > 0")
        assert page.part("group").locator("option").all_text_contents() == ["arm", "arm_with_torso"]
        page.part("group").select_option("arm_with_torso")
        page.part("joint-torso_lift_joint-number").wait_for()
        joints = page.part("joints").locator("b").all_text_contents()
        assert len(joints) == 8
        assert_every_panel_shows(page, joints)
        before_m = tip(fetch.url, "gripper_link")
        set_speed(page, 100)
        page.part("named-tucked").click()
        page.part("plan-and-move").click()
        page.until_state("s.goal.code === 1")
        assert math.dist(tip(fetch.url, "gripper_link"), before_m) > MOVED_M
        assert page.errors == []


def test_two_arms_are_shown_and_each_is_moved_by_its_group(browser: Browser, settings: dict[str, str]) -> None:
    own = {key: value for key, value in settings.items() if not key.startswith("ARMBRIDGE_ARM__")}
    with (
        RunningServer(f"--port 0 --config {ROOT / 'examples' / 'two_arms.toml'}", own) as arms,
        opened(browser) as page,
    ):
        page.open(arms.port)
        page.until_state("s.robot !== null && Object.keys(s.limits).length > 0")
        assert page.part("group").locator("option").all_text_contents() == ["left_arm", "right_arm", "both_arms"]
        before = page.joints()
        page.part("group").select_option("right_arm")
        page.part("joint-right_elbow_flex-number").wait_for()
        page.part("named-ready").click()
        page.part("plan-and-move").click()
        page.until_state("s.goal.code === 1")
        after = page.joints()
        assert after["right_shoulder_lift"] == pytest.approx(-0.5, abs=ON_SERVOS)
        assert after["left_shoulder_lift"] == pytest.approx(before["left_shoulder_lift"], abs=ON_SERVOS)
        # Driven by hand, too.
        page.open_panel("drive")
        page.part("drive-mode").select_option("hold")
        for control, moved in (
            ("jog-right_wrist_roll-plus", "right_wrist_roll"),
            ("jog-z-plus", "right_shoulder_lift"),
            ("jog-gripper-plus", "right_gripper"),
        ):
            before = page.joints()

            def moves(moved: str = moved, before: dict[str, float] = before) -> bool:
                return abs(page.joints()[moved] - before[moved]) > 0.05

            hold_until(moves, functools.partial(hold, page, control), page.page.mouse.up)
            page.page.mouse.up()
            after = page.joints()
            for joint in (name for name in before if name.startswith("left_")):
                assert after[joint] == pytest.approx(before[joint], abs=ON_SERVOS)
        assert_both_are_moved_by_one_goal_and_not_by_hand(page, arms)
        assert page.errors == []


def assert_both_are_moved_by_one_goal_and_not_by_hand(page: OpenPage, arms: RunningServer) -> None:
    """Choose the group of both arms: what it cannot do is not offered."""
    page.open_panel("move")
    page.part("group").select_option("both_arms")
    page.part("section-target").wait_for(state="hidden")
    page.wait(page.part("section-gripper").is_hidden)
    # No sentence tells of the ball, which belongs to one arm.
    page.until_text("next-step", "a pose or joints in Move")
    page.open_panel("settings")
    page.part("tour-start").click()
    page.until_text("tour-text", "choose a pose or joints")
    page.part("tour-next").click(click_count=4)
    page.part("named-home").click()
    page.part("plan-and-move").click()
    page.until_state("s.goal.code === 1 && s.selection.kind === 'none'")
    assert {name: at for name, at in page.joints().items() if name.endswith("shoulder_lift")} == pytest.approx(
        {"left_shoulder_lift": 0.0, "right_shoulder_lift": 0.0}, abs=ON_SERVOS
    )
    page.open_panel("drive")
    page.until_text("drive-status", "One arm is driven at a time")
    assert page.part("jog-z-plus").is_hidden()
    # Nothing was asked that the server refuses.
    assert not [line for line in arms.lines if "INVALID_LINK_NAME" in line or "has no tip" in line]


def test_a_joint_that_slides_is_moved_by_a_number_in_millimetres(page: OpenPage) -> None:
    page.enter("joint-lift-number", "150")
    page.part("plan-and-move").click()
    page.until_state("s.goal.code === 1")
    assert page.joints()["lift"] == pytest.approx(0.15, abs=ARRIVED)
    assert page.errors == []


def test_a_target_of_an_arm_with_seven_joints_has_an_orientation(page: OpenPage) -> None:
    page.enter("target-roll", "30")
    x, y, z, w = page.state("target.orientation")
    assert x * x + y * y + z * z + w * w == pytest.approx(1)
    assert page.part("target-pitch").is_visible()
    page.until_state("s.target.reachable !== null")


def test_a_group_of_few_joints_has_points_for_targets_and_a_list_of_its_own(page: OpenPage) -> None:
    page.part("group").select_option("upper")
    page.until("document.querySelectorAll('[data-testid=joints] b').length === 4")
    assert page.part("joints").locator("b").all_text_contents() == JOINTS[:4]
    page.part("target-roll").wait_for(state="hidden")
    assert page.part("named-bent").count() == 0
    page.part("group").select_option("arm")
    page.part("named-bent").wait_for()
    page.part("target-roll").wait_for()
