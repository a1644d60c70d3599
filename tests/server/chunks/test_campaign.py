"""Chunks of noisy and of hostile policies among objects: the independent judge finds no contact, and the jerk is kept.

CHUNK_SEEDS=200 (make campaign-chunks) tries as many others of each kind.
"""

import asyncio
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from harness.full_meshes import Judge
from robot.description.limits import motion_limits
from robot.trajectory import PERIOD_S, Vector
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import ROBOT, box, diff
from tests.helpers.moveit import point as frame_point
from tests.helpers.resources import shared_data
from tests.helpers.stage import ARM_JOINTS, COLUMNS
from tests.server.chunks.test_action_chunks import HZ, Policy, chunk, now_s, policy

__all__ = ["policy"]

pytestmark = pytest.mark.stepped_time

SEEDS = range(10, 10 + int(os.environ["CHUNK_SEEDS"])) if "CHUNK_SEEDS" in os.environ else range(1)
LIMITS = motion_limits(ROBOT, ARM_JOINTS, 1.0)
NOISE_RAD = 0.05
LAG_S = 0.02
# Objects keep this distance from where the arm begins [m].
FREE_M = 0.03
OBJECTS = 10
PLAYED_S = 6.0


def judge_of(objects: list[dict[str, object]]) -> Judge:
    fields = json.loads((shared_data() / "planning_problems" / "empty.json").read_text())
    more = {"joint_names": list(ARM_JOINTS), "gripper": HOME["gripper"], "objects": objects}
    return Judge(shared_data(), fields | more)


def solid(name: str, at_m: Vector, size_m: Vector) -> dict[str, object]:
    pose = {"position": at_m.tolist(), "orientation": [0.0, 0.0, 0.0, 1.0]}
    return {"id": name, "type": "box", "dimensions": size_m.tolist(), "pose": pose}


def add_objects(policy: Policy, rng: np.random.Generator) -> Judge:
    """Put boxes around the arm where it stands, and return the judge of them."""
    found: dict[str, tuple[Vector, Vector]] = {}
    while len(found) < OBJECTS:
        angle, away_m, size_m = rng.uniform(-2.5, 2.5), rng.uniform(0.1, 0.4), rng.uniform(0.02, 0.1, 3)
        at_m = np.array([away_m * np.cos(angle), away_m * np.sin(angle), rng.uniform(0.0, 0.4)])
        if not judge_of([solid("wide", at_m, size_m + 2.0 * FREE_M)]).collides(np.zeros(len(ARM_JOINTS))):
            found[f"box {len(found)}"] = at_m, size_m
    boxes = [
        box(name, at=frame_point(*at_m.tolist()), primitives=[{"type": 1, "dimensions": size_m.tolist()}])
        for name, (at_m, size_m) in found.items()
    ]
    policy.stage.context.planning.scene_state.apply_diff(diff(world={"collision_objects": boxes}), HOME)
    return judge_of([solid(name, *place) for name, place in found.items()])


async def until_quiet(policy: Policy) -> None:
    at = None
    while at is None or not (policy.goals_rad[-1] == at).all():
        at = policy.goals_rad[-1]
        await asyncio.sleep(0.3)


def assert_answered_within_limits(policy: Policy, sent: int) -> None:
    policy.assert_within_limits()
    assert {answer["id"] for answer in policy.answers} == set(map(str, range(sent)))


def assert_free(policy: Policy, judge: Judge) -> None:
    assert not any(judge.collides(goal_rad) for goal_rad in np.unique(policy.arm_rad[::2], axis=0))


async def play(policy: Policy, rng: np.random.Generator, period_s: float, targets: Callable[[float], Vector]) -> None:
    """Send overlapping chunks of the targets from a time on [s], and assert that each is followed within the jerk."""
    blend, began_s, sent = str(rng.choice(["replace", "ensemble", "real_time"])), now_s(), 0
    while (at_s := now_s() - began_s) < PLAYED_S:
        policy.publish(chunk(targets(at_s), stamp_s=began_s + at_s, blend=blend, weight=0.6, id=str(sent)))
        sent += 1
        await asyncio.sleep(period_s)
    await until_quiet(policy)
    assert_answered_within_limits(policy, sent)
    assert len(policy.answers) == sent
    for order, limit in ((2, LIMITS.acceleration), (3, LIMITS.jerk)):
        assert (np.abs(np.diff(policy.arm_rad, order, axis=0)) / PERIOD_S**order <= 1.001 * limit).all()


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise_rad", [0.0, NOISE_RAD])
async def test_a_policy_of_1_rad_s_is_followed_with_20_ms_of_lag(policy: Policy, seed: int, noise_rad: float) -> None:
    rng = np.random.default_rng(seed)
    swing_rad = rng.uniform(0.2, 0.6, len(ARM_JOINTS)) * rng.choice([-1.0, 1.0], len(ARM_JOINTS))

    def wanted(time_s: Vector) -> Vector:
        return swing_rad * np.sin(time_s[:, np.newaxis] / np.abs(swing_rad))

    count, before = int(rng.integers(24, 60)), len(policy.goals_rad)

    def noisy(at_s: float) -> Vector:
        targets = wanted(at_s + np.arange(1, count + 1) / HZ)
        return targets + rng.normal(0.0, noise_rad, targets.shape)

    await play(policy, rng, float(rng.uniform(0.1, 0.6)), noisy)
    time_s = (np.arange(len(policy.goals_rad)) - before + 1) * PERIOD_S
    led = (time_s > 1.0) & (time_s < PLAYED_S)
    behind = (wanted(time_s) - policy.arm_rad)[led]
    speed = np.gradient(wanted(time_s), PERIOD_S, axis=0)[led]
    assert abs((behind * speed).sum() / (speed**2).sum()) < LAG_S


@pytest.mark.parametrize("seed", SEEDS)
async def test_recorded_chunks_of_an_act_policy_are_followed_within_the_jerk(policy: Policy, seed: int) -> None:
    """Chunks of lerobot's ACT after three steps of training, from every fifth image of an episode."""
    recorded = np.load(Path(__file__).with_name("act_chunks.npz"))["targets_rad"]
    rng = np.random.default_rng(seed)
    period_s = float(rng.uniform(0.1, 0.5))
    await play(policy, rng, period_s, lambda at_s: recorded[int(at_s / period_s) % len(recorded)])
    assert np.ptp(policy.arm_rad, axis=0).max() > 0.01


@pytest.mark.parametrize("seed", SEEDS)
async def test_chunks_of_any_kind_among_ten_objects_touch_nothing(policy: Policy, seed: int) -> None:
    rng = np.random.default_rng(seed)
    judge, sent = add_objects(policy, rng), 0
    for _ in range(14):
        here = policy.goals_rad[-1][COLUMNS] if policy.goals_rad else np.zeros(len(COLUMNS))
        count = int(rng.integers(2, 60))
        speed = rng.uniform(-2.5, 2.5, len(COLUMNS)) * (rng.random(len(COLUMNS)) < 0.6)
        noise = rng.normal(0.0, float(rng.choice([0.0, 0.01, NOISE_RAD])), (count, len(COLUMNS)))
        targets = here + np.arange(1, count + 1)[:, np.newaxis] / HZ * speed + noise
        blend = str(rng.choice(["replace", "ensemble", "real_time"]))
        policy.publish(
            chunk(targets, stamp_s=now_s() - float(rng.uniform(0.0, 0.3)), blend=blend, weight=0.6, id=str(sent))
        )
        sent += 1
        await asyncio.sleep(float(rng.uniform(0.05, 0.8)))
    await until_quiet(policy)
    assert_answered_within_limits(policy, sent)
    assert_free(policy, judge)
