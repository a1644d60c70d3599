"""Scenes in parts: what is sent, and what the receiver makes of it."""

import asyncio
from functools import partial

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planners.messages import OBJECT_BYTES, PART_BYTES, SceneReceiver, SceneSender, parts
from planners.scene import Box, Mesh, Pose, Scene, SceneObject
from tests.planners.scenes import boxes


async def test_a_scene_arrives_as_it_was_and_is_sent_once() -> None:
    receiver, sent = SceneReceiver(), []
    sender = SceneSender(sent.append, partial(asyncio.sleep, 0))
    for scene, messages in ((Scene(1, boxes(600)), 6), (Scene(1, boxes(600)), 0), (Scene(2, boxes(1)), 2)):
        sent.clear()
        await sender.send(scene)
        assert len(sent) == messages
        for message in sent:
            receiver.take(message)
        assert receiver.scene() == scene


meshes = st.integers(0, 3 * PART_BYTES // 24).map(
    lambda vertices: Mesh(np.zeros((vertices, 3)), np.zeros((0, 3), dtype=np.int32))
)


@given(st.lists(st.one_of(meshes, st.just(Box((1.0, 1.0, 1.0)))), max_size=20))
async def test_parts_hold_all_objects_in_order_and_none_could_do_with_fewer(shapes: list[Mesh | Box]) -> None:
    objects = tuple(SceneObject(str(i), ((shape, Pose()),)) for i, shape in enumerate(shapes))
    divided = list(parts(objects))
    assert tuple(each for part in divided for each in part) == objects
    for part in divided:
        sizes = [
            OBJECT_BYTES + (shape.vertices_m.nbytes if isinstance(shape, Mesh) else 0)
            for each in part
            for shape, _ in each.shapes
        ]
        assert sum(sizes[:-1]) < PART_BYTES
