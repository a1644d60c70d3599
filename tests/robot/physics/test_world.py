"""Bodies in the physical world, and where they are placed."""

import logging
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from robot.errors import DescriptionError
from robot.physics.bodies import Body, BodyShape, BodyState, BodyStates, Point, SetBodies
from robot.physics.placing import DRAWN_WITHIN_M, placed
from robot.physics.world import World
from tests.helpers.robots import so101
from tests.robot.physics.test_servo_joints import BARE, Driven, driven, world_of

LEVEL = (0.0, 0.0, 0.0, 1.0)
# Pointing down beside the block, the block between the open fingers, and the same lifted.
AROUND = {"shoulder_lift": -0.184, "elbow_flex": 0.628, "wrist_flex": 1.128, "wrist_roll": -1.52, "gripper": 1.0}
GRIPPER, SHOULDER_LIFT = 5, 1
FAR = (0.3, 0.3, 0.02)


def box(name: str, at: Point, half_m: float = 0.0125, *, movable: bool = True) -> Body:
    return Body(name, (BodyShape("box", (half_m, half_m, half_m), (0.0, 0.0, 0.0), LEVEL),), at, LEVEL, movable)


BLOCK_SHAPE = BodyShape("box", (0.0125, 0.0125, 0.025), (0.0, 0.0, 0.0), LEVEL)
BLOCK = replace(box("block", (0.2, -0.009, 0.025)), shapes=(BLOCK_SHAPE,), mass_kg=0.02)

# MuJoCo refuses a flat body.
FLAT = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.1, 0.1, 0.0))
SHEET = Body("sheet", (BodyShape("hull", (), (0.0, 0.0, 0.0), LEVEL, FLAT),), FAR, LEVEL, movable=True)


@pytest.fixture
def arm() -> Driven:
    return driven(physics=True, start_rad={})


def state_of(world: World, name: str) -> BodyState:
    return next(each for each in world.moved_bodies(every=True).bodies if each.name == name)


def test_a_body_falls_onto_the_floor_or_onto_another_and_stays_there(arm: Driven) -> None:
    world = world_of(arm)
    table = box("table", (0.3, -0.3, 0.02), 0.02, movable=False)
    world.set_bodies(SetBodies(3, (box("high", (0.3, 0.3, 0.1)), box("on table", (0.3, -0.3, 0.1)), table)))
    first = world.moved_bodies(every=False)
    assert (first.version, {each.name for each in first.bodies}) == (3, {"high", "on table"})
    arm.tick(100)
    assert state_of(world, "high").position_m == pytest.approx((0.3, 0.3, 0.0125), abs=0.001)
    assert state_of(world, "on table").position_m == pytest.approx((0.3, -0.3, 0.0525), abs=0.001)
    arm.tick(50)
    assert world.moved_bodies(every=False) is None
    assert isinstance(world.moved_bodies(every=True), BodyStates)


@pytest.mark.parametrize("place", [0, 4], ids=["position", "orientation"])
def test_a_body_that_only_moved_or_only_turned_has_moved(arm: Driven, place: int) -> None:
    world = world_of(arm)
    world.set_bodies(SetBodies(1, (box("cube", FAR),)))
    assert world.moved_bodies(every=False) is not None
    at = world.model.jnt_qposadr[world.model.body("object/cube").jntadr[0]]
    world.data.qpos[at + place] += 0.02
    world.data.qpos[at + 3 : at + 7] /= np.linalg.norm(world.data.qpos[at + 3 : at + 7])
    mujoco.mj_forward(world.model, world.data)
    assert world.moved_bodies(every=False) is not None
    assert world.moved_bodies(every=False) is None


def test_other_bodies_leave_arm_and_bodies_where_they_are(arm: Driven) -> None:
    world = world_of(arm)
    world.set_bodies(SetBodies(1, (box("cube", (0.3, 0.3, 0.1)),)))
    before = arm.tick(100).position_rad
    fallen = state_of(world, "cube")
    world.set_bodies(SetBodies(2, (box("cube", (0.3, 0.3, 0.1)), box("wall", FAR, movable=False))))
    assert arm.tick().position_rad == pytest.approx(before, abs=0.002)
    assert state_of(world, "cube").position_m == pytest.approx(fallen.position_m, abs=0.001)
    world.set_bodies(SetBodies(3, (box("cube", (0.2, 0.3, 0.1)), box("wall", FAR, movable=False))))
    assert state_of(world, "cube").position_m == pytest.approx((0.2, 0.3, 0.1))
    arm.tick(100)
    placed = {"cube": ((0.25, 0.3, 0.1), LEVEL), "wall": ((0.2, 0.2, 0.2), LEVEL), "gone": ((0.0, 0.0, 0.0), LEVEL)}
    world.set_bodies(SetBodies(4, (box("cube", (0.2, 0.3, 0.1)), box("wall", FAR, movable=False)), placed))
    assert state_of(world, "cube").position_m == pytest.approx((0.25, 0.3, 0.1))
    world.set_bodies(SetBodies(5, ()))
    assert world.moved_bodies(every=True) is None
    assert arm.tick().position_rad == pytest.approx(before, abs=0.002)


def test_a_fixed_body_carries_others_where_it_is_put_without_a_new_model(arm: Driven) -> None:
    world = world_of(arm)
    table, cube = box("table", (0.3, -0.3, 0.02), 0.02, movable=False), box("cube", (0.3, -0.3, 0.06))
    world.set_bodies(SetBodies(1, (table,)))
    world.set_bodies(SetBodies(2, (table, cube)))
    model = world.model
    for at in (table, replace(table, position_m=(0.3, -0.3, 0.01))):
        world.set_bodies(SetBodies(3, (at, cube)))
        arm.tick(50)
        assert state_of(world, "cube").position_m[2] == pytest.approx(at.position_m[2] + 0.0325, abs=0.001)
    assert world.model is model


def test_an_arm_pushes_a_movable_body_and_is_stopped_by_a_fixed_one() -> None:
    turned = {}
    for movable in (True, False):
        arm = driven(physics=True, start_rad=AROUND)
        world_of(arm).set_bodies(SetBodies(1, (replace(BLOCK, position_m=(0.2, -0.06, 0.025), movable=movable),)))
        arm.move(0, 0.6, 100)
        turned[movable] = arm.tick(60).position_rad[0]
        if movable:
            assert state_of(world_of(arm), "block").position_m[1] < -0.07
    assert turned[True] == pytest.approx(0.6, abs=0.02)
    assert turned[False] < 0.4


def test_the_floor_stops_a_link_and_carries_it_and_the_base_stands_in_it() -> None:
    arm = driven(robot=so101(), physics=True, start_rad={})
    world = world_of(arm)
    assert world.overlaps({"base_link", "floor"}) == []
    arm.move(SHOULDER_LIFT, 0.9, 90)
    stopped = arm.tick(30)
    assert stopped.position_rad[SHOULDER_LIFT] < 0.75
    assert abs(stopped.load[SHOULDER_LIFT]) > 0.3
    for first, _, depth_m in world.overlaps({"floor"}):
        assert (first, depth_m < 0.004) == ("floor", True)
    arm.move(SHOULDER_LIFT, 0.0, 90)
    assert arm.tick(50).position_rad[SHOULDER_LIFT] == pytest.approx(0.0, abs=0.06)


def test_fingers_that_close_on_a_body_hold_it_lift_it_and_drop_it_unless_it_is_slippery() -> None:
    arm = driven(robot=so101(), physics=True, start_rad=AROUND)
    world = world_of(arm)
    world.set_bodies(SetBodies(1, (BLOCK,)))
    arm.tick(10)
    assert not state_of(world, "block").held
    arm.move(GRIPPER, -0.1, 100)
    assert arm.tick(50).position_rad[GRIPPER] == pytest.approx(0.07, abs=0.05)
    assert state_of(world, "block").held
    arm.move(SHOULDER_LIFT, -0.6, 100)
    arm.tick(100)
    lifted = state_of(world, "block")
    assert lifted.held
    assert lifted.position_m[2] > 0.08
    arm.move(GRIPPER, 1.0, 60)
    arm.tick(100)
    dropped = state_of(world, "block")
    assert not dropped.held
    assert dropped.position_m[2] < 0.03
    arm = driven(robot=so101(), physics=True, start_rad=AROUND)
    world_of(arm).set_bodies(SetBodies(1, (replace(BLOCK, friction=0.01, mass_kg=0.5),)))
    arm.move(GRIPPER, -0.1, 100)
    arm.move(SHOULDER_LIFT, -0.6, 100)
    assert state_of(world_of(arm), "block").position_m[2] < 0.05


def test_a_rough_body_slides_on_the_floor_as_on_wood_and_a_slippery_one_as_far_as_it_would(arm: Driven) -> None:
    world = world_of(arm)
    sides = {"rough": (0.3, 1.0, 0.5), "slippery": (-0.3, 0.1, 0.1)}
    bodies = [replace(box(name, (0.3, y, 0.0125)), friction=friction) for name, (y, friction, _) in sides.items()]
    world.set_bodies(SetBodies(1, tuple(bodies)))
    arm.tick(20)
    for name in sides:
        world.data.qvel[world.model.body(f"object/{name}").dofadr[0]] = 0.5
    arm.tick(100)
    for name, (_, _, on_the_floor) in sides.items():
        way_m = state_of(world, name).position_m[0] - 0.3
        assert way_m == pytest.approx(0.5**2 / (2.0 * on_the_floor * 9.81), rel=0.2), name


def test_bodies_that_overlap_are_named_once_with_the_depth(arm: Driven, caplog: pytest.LogCaptureFixture) -> None:
    left = box("left", (0.3, 0.3, 0.0125))
    with caplog.at_level(logging.WARNING):
        for version, shift_m in enumerate((0.0, 0.0002, 0.0004)):
            world_of(arm).set_bodies(SetBodies(version, (left, box("right", (0.3, 0.32 + shift_m, 0.0125)))))
    assert caplog.messages == ["physics: 'left' overlaps 'right' by 5 mm; they push each other apart"]
    arm.tick(100)


def test_a_body_that_mujoco_refuses_is_left_out_with_a_sentence(arm: Driven, caplog: pytest.LogCaptureFixture) -> None:
    before = arm.tick().position_rad
    world_of(arm).set_bodies(SetBodies(1, (BLOCK,)))
    with caplog.at_level(logging.WARNING):
        world_of(arm).set_bodies(SetBodies(2, (BLOCK, SHEET)))
    assert "physics: 'sheet' cannot be simulated, and are left out: " in caplog.text
    assert state_of(world_of(arm), "block").position_m == pytest.approx(BLOCK.position_m, abs=0.001)
    assert arm.tick(10).position_rad == pytest.approx(before, abs=0.002)


def test_every_kind_of_shape_carries_a_body(arm: Driven) -> None:
    corners = tuple((x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.02, 0.02))
    # A plane goes on below the others.
    shapes = {
        "sphere": (BodyShape("sphere", (0.02,), (0.0, 0.0, 0.0), LEVEL), (0.3, 0.3, 0.05)),
        "cylinder": (BodyShape("cylinder", (0.05, 0.02), (0.0, 0.0, 0.0), LEVEL), (0.3, -0.3, 0.05)),
        "hull": (BodyShape("hull", (), (0.0, 0.0, 0.0), LEVEL, corners), (-0.3, 0.3, 0.05)),
        "plane": (BodyShape("plane", (), (0.0, 0.0, 0.02), LEVEL), (-0.3, -0.3, -0.015)),
    }
    bodies = [Body(kind, (shape,), at, LEVEL) for kind, (shape, at) in shapes.items()]
    cubes = [box(f"on {kind}", (x, y, z + 0.04)) for kind, (_, (x, y, z)) in shapes.items()]
    world = world_of(arm)
    world.set_bodies(SetBodies(1, (*bodies, *cubes)))
    arm.tick(60)
    for kind, (_, (x, y, z)) in shapes.items():
        assert state_of(world, f"on {kind}").position_m == pytest.approx((x, y, z + 0.0325), abs=0.002), kind


# Side by side, with 3 mm between them.
ROW = tuple(box(str(at), (0.3, -0.05 + 0.028 * at, 0.013)) for at in range(4))


def test_bodies_stay_in_their_places_or_a_seed_draws_the_same_places_again_and_nothing_overlaps() -> None:
    assert placed(BARE, ROW, 0) == ROW
    wall = box("wall", FAR, movable=False)
    lying = replace(box("lying", (-0.3, 0.3, 0.02)), orientation=(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    drawn = placed(BARE, (*ROW, lying, wall), 7)
    assert drawn == placed(BARE, (*ROW, lying, wall), 7)
    assert drawn != placed(BARE, (*ROW, lying, wall), 8)
    assert drawn[-1] == wall
    for body, before in zip(drawn, ROW, strict=False):
        assert body.position_m != before.position_m
        assert np.abs(np.subtract(body.position_m, before.position_m)).max() <= DRAWN_WITHIN_M
        assert body.position_m[2] == before.position_m[2]
        assert math.hypot(*body.orientation) == pytest.approx(1.0)
    # The y axis of a body that lies still points up.
    x, y, z, w = drawn[-2].orientation
    assert 2.0 * (y * z + w * x) == pytest.approx(1.0)
    assert placed(BARE, drawn, 0) == drawn


def test_a_body_without_room_stays_in_its_place() -> None:
    around = ((-0.05, 0.0), (0.05, 0.0), (0.0, -0.05), (0.0, 0.05))
    walls = [box(str((dx, dy)), (0.3 + dx, dy, 0.03), 0.03, movable=False) for dx, dy in around]
    peg = Body("peg", (BodyShape("box", (0.019, 0.019, 0.01), (0.0, 0.0, 0.0), LEVEL),), (0.3, 0.0, 0.01), LEVEL, True)
    assert np.abs(np.subtract(placed(BARE, (*walls, peg), 3)[-1].position_m, peg.position_m)).max() < 0.005


BESIDE = (0.3, 0.31, 0.0125)
REFUSED = {
    "'left' overlaps 'right' by 5 mm, more than 2 mm": (box("left", (0.3, 0.29, 0.0125)), box("right", BESIDE)),
    "'floor' overlaps 'low' by 12 mm, more than 2 mm": (box("low", (0.3, 0.3, 0.0)),),
    "overlaps 'inside' by ": (box("inside", (0.0, 0.0, 0.03)),),
    "'sheet' cannot be simulated": (SHEET,),
}


@pytest.mark.parametrize(("sentence", "bodies"), REFUSED.items())
def test_bodies_that_no_world_begins_with_are_refused(sentence: str, bodies: tuple[Body, ...]) -> None:
    with pytest.raises(DescriptionError, match=sentence):
        placed(BARE, bodies, 0)
