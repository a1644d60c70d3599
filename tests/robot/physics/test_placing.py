import math
from dataclasses import replace

import numpy as np
import pytest

from robot.errors import DescriptionError
from robot.physics.bodies import Body, BodyShape
from robot.physics.placing import DRAWN_WITHIN_M, placed
from tests.robot.physics.test_servo_joints import BARE
from tests.robot.physics.test_world import FAR, LEVEL, SHEET, box

# Side by side, with 3 mm between them.
ROW = tuple(box(str(at), (0.3, -0.05 + 0.028 * at, 0.013)) for at in range(4))


def test_bodies_stay_in_their_places_without_a_seed() -> None:
    assert placed(BARE, ROW, 0) == ROW


def test_a_seed_draws_the_same_places_again_and_nothing_overlaps() -> None:
    wall = box("wall", FAR, movable=False)
    drawn = placed(BARE, (*ROW, wall), 7)
    assert drawn == placed(BARE, (*ROW, wall), 7)
    assert drawn != placed(BARE, (*ROW, wall), 8)
    assert drawn[-1] == wall
    for body, before in zip(drawn, ROW, strict=False):
        assert body.position_m != before.position_m
        assert np.abs(np.subtract(body.position_m, before.position_m)).max() <= DRAWN_WITHIN_M
        assert body.position_m[2] == before.position_m[2]
        assert math.hypot(*body.orientation) == pytest.approx(1.0)
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


def test_a_turned_body_is_turned_about_the_root_s_axis() -> None:
    lying = replace(box("lying", FAR), orientation=(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    x, y, z, w = placed(BARE, (lying,), 1)[0].orientation
    # The body's y axis still points up.
    assert 2.0 * (y * z + w * x) == pytest.approx(1.0)
