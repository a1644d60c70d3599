import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robot.description.robot_folder import built_in
from robot.messages import (
    END_TIMEOUT_S,
    PARKING_TIMEOUT_S,
    ChangePace,
    Command,
    EmergencyPolicy,
    EndState,
    Execute,
    KeepParking,
    Mode,
    Order,
    Outcome,
    ParkingPlan,
    PlaybackDirection,
    Shutdown,
    Stop,
    Stream,
)
from robot.trajectory import Trajectory
from tests.helpers.arm_rig import NAMES, ArmRig
from tests.helpers.motions import smooth_move

REST = built_in("so101").model.named_states["arm"]["rest"]
PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, 2.0)

# A relaxed elbow sinks until its stop holds it.
SINK_RAD = 0.1


def way_to_rest(duration_s: float = 3.0) -> ParkingPlan:
    """Way from where every joint is at 0."""
    trajectory = smooth_move({name: (0.0, position) for name, position in REST.items()}, duration_s)
    return ParkingPlan(trajectory, dict.fromkeys(NAMES, 0.0))


def held(position_rad: float) -> KeepParking:
    """A way that was planned with every joint at a position."""
    return KeepParking(replace(way_to_rest(), held_rad=dict.fromkeys(NAMES, position_rad)))


@pytest.fixture
def rig() -> ArmRig:
    rig = ArmRig(on_server_lost=EndState.PARK, on_exit=EndState.PARK).started()
    rig.supervisor.handle(KeepParking(way_to_rest()))
    return rig


@pytest.fixture
def moving(rig: ArmRig) -> ArmRig:
    """An arm in the middle of a motion."""
    rig.execute(PAN)
    rig.run(1.0)
    return rig


def lose_server(rig: ArmRig) -> None:
    rig.alive = False
    rig.supervisor.lose_server()


def until_ended(rig: ArmRig, timeout_s: float = PARKING_TIMEOUT_S + END_TIMEOUT_S + 1.0) -> None:
    rig.until(lambda: rig.supervisor.finished(), timeout_s)


def distance_to_rest(rig: ArmRig) -> float:
    """Greatest distance of a joint from the rest pose, by the servos."""
    at = dict(zip(NAMES, rig.state.position_rad.tolist(), strict=True))
    return max(abs(at[name] - position) for name, position in REST.items())


@pytest.mark.parametrize("orderly", [True, False], ids=["shut down", "server gone"])
def test_an_end_at_rest_leaves_a_parked_and_relaxed_arm_that_hardly_sinks(
    rig: ArmRig, caplog: pytest.LogCaptureFixture, orderly: bool
) -> None:
    caplog.set_level(logging.INFO)
    rig.supervisor.handle(held(0.009))
    if orderly:
        rig.supervisor.handle(Shutdown())
    else:
        lose_server(rig)
    until_ended(rig)
    assert rig.torque() == [0] * 6
    steps = "the arm moves to its rest pose, in 3.0 s", "the arm is at its rest pose, and is relaxed"
    assert [line for line in caplog.messages if line.startswith("parking")] == [f"parking: {step}" for step in steps]
    rig.run(5.0)
    assert distance_to_rest(rig) < SINK_RAD


def test_a_server_that_is_gone_in_mid_motion_sends_the_arm_back_before_it_parks(moving: ArmRig) -> None:
    assert moving.state.goal_rad[0] > 0.3
    # Another motion, which is back earlier.
    moving.execute(smooth_move({"wrist_roll": (0.0, 0.5)}, 2.0), motion_id=2)
    moving.run(0.3)
    lose_server(moving)
    moving.until(lambda: abs(moving.state.goal_rad[0]) < 1e-6)
    assert np.allclose(moving.state.goal_rad[1:], 0.0, atol=0.02), "the arm parks before it is back"
    until_ended(moving)
    assert moving.outcomes == [Outcome.STOPPED, Outcome.STOPPED, Outcome.REACHED]
    assert distance_to_rest(moving) < SINK_RAD


@pytest.mark.parametrize("was_moving", [True, False])
def test_an_arm_whose_process_stands_still_shortly_while_it_parks_goes_on_to_its_rest_pose(
    rig: ArmRig, was_moving: bool
) -> None:
    if was_moving:
        rig.execute(PAN)
        rig.run(1.0)
    lose_server(rig)
    rig.run(0.8)
    rig.clock.advance(4.0)
    until_ended(rig)
    assert distance_to_rest(rig) < SINK_RAD


STEERED, PAUSED = Stream(1, ("shoulder_pan",)), ChangePace(direction=PlaybackDirection.PAUSED)
GRIP = Execute(2, smooth_move({"gripper": (0.0, 1.0)}, 2.0), gripping=True)
MOVES = (Execute(1, PAN), 1.0)
PARKS = (Shutdown(), 0.5)
ELSEWHERE = "planned with joint {} at 0.000 rad, which is at 0.300 rad"
NO_TIME = f"not at its rest pose after {PARKING_TIMEOUT_S:g} s"
CHANGED = "the scene has changed since the way to the rest pose was planned; the arm is relaxed"
# What happens: messages, waits [s], commands of the emulator and the loss of the server; and words of the log.
UNPARKED: dict[str, tuple[tuple[Any, ...], str]] = {
    "it has no way": ((KeepParking(None), 0.01, lose_server), "no way to the rest pose is known"),
    "it was planned from elsewhere": ((held(-0.011), 0.01, lose_server), "(tolerance 0.01 rad)"),
    **{
        f"its {joint} has moved since": (
            (Execute(1, smooth_move({joint: (0.0, 0.3)}, 1.0)), 1.5, lose_server),
            ELSEWHERE.format(joint),
        )
        for joint in ("wrist_roll", "gripper")
    },
    "its way takes long": ((KeepParking(way_to_rest(15.1)), 0.01, lose_server), "would take 15.1 s, above the limit"),
    "its way is too fast": ((KeepParking(way_to_rest(0.3)), 0.01, lose_server), "rad/s, above its limit of"),
    "it stands still": ((ChangePace(speed_factor=0.0), 0.01, lose_server), "the speed factor is 0"),
    "it is slow": ((ChangePace(speed_factor=0.05), 0.01, lose_server), NO_TIME),
    "it is steered": ((STEERED, 0.01, lose_server), "no way back"),
    "its motion is paused": ((*MOVES, PAUSED, 0.5, lose_server), "the motion is paused"),
    "its motion stands still": ((*MOVES, ChangePace(speed_factor=0.0), 0.5, lose_server), "the motion is paused"),
    "its motion is stopped": ((*MOVES, Stop(), 0.01, lose_server), "no way back"),
    "it grips": ((*MOVES, GRIP, 0.01, lose_server), "no way back"),
    "the scene changes on its way": ((*PARKS, KeepParking(None)), f"parking: {CHANGED}"),
    "the server hurries": (
        (*PARKS, Shutdown(hurry=True)),
        "parking: the server must not wait; the arm is relaxed where",
    ),
    "it is stopped on its way": ((*PARKS, Stop()), "parking: the arm stands at "),
    "it is stopped for an emergency": ((*PARKS, Command(1, Order.EMERGENCY_STOP)), "parking: the arm has a fault: "),
    "it is hot": ((*PARKS, {"temperature": {"3": 68}}), "parking: the arm has a fault: joint elbow_flex is at 68 degC"),
    "it was stopped before its end": ((Stop(epoch=2), Shutdown(1)), ""),
    "it is stopped after its end was requested": ((Shutdown(1), Stop(epoch=2)), ""),
}


@pytest.mark.parametrize(("happens", "words"), UNPARKED.values(), ids=UNPARKED)
def test_an_arm_that_cannot_be_parked_is_relaxed_where_it_is_and_the_reason_logged_once(
    rig: ArmRig, caplog: pytest.LogCaptureFixture, happens: tuple[Any, ...], words: str
) -> None:
    for each in happens:
        if callable(each):
            each(rig)
        elif isinstance(each, float):
            rig.run(each)
        elif isinstance(each, dict):
            rig.emulator.command(**each)
        else:
            rig.supervisor.handle(each)
    until_ended(rig)
    assert rig.torque() == [0] * 6
    assert distance_to_rest(rig) > 0.3
    assert words == "" or caplog.text.count(words) == 1


def test_an_arm_at_its_rest_pose_is_relaxed_at_once(rig: ArmRig) -> None:
    plan = way_to_rest()
    rig.execute(plan.trajectory)
    rig.until(lambda: bool(rig.ended))
    there = plan.trajectory.sample(plan.trajectory.duration_s)[0]
    held = dict.fromkeys(NAMES, 0.0) | dict(zip(plan.trajectory.joint_names, there.tolist(), strict=True))
    still = np.zeros((1, len(there)))
    nowhere = Trajectory(plan.trajectory.joint_names, np.zeros(1), there[np.newaxis], still, still)
    rig.supervisor.handle(KeepParking(ParkingPlan(nowhere, held)))
    lose_server(rig)
    until_ended(rig, 4.0)
    assert rig.torque() == [0] * 6


def test_a_server_that_is_silent_at_rest_is_waited_for_before_the_arm_parks(rig: ArmRig) -> None:
    rig.alive = False
    rig.run(4.99)
    assert rig.mode is Mode.HOLDING
    rig.run(0.03)
    assert rig.mode is Mode.MOVING
    rig.until_mode(Mode.RELAXED)
    assert distance_to_rest(rig) < SINK_RAD


@pytest.mark.parametrize("braking", [True, False], ids=["brakes", "parks"])
def test_a_server_that_comes_back_while_the_arm_brakes_or_parks_finds_it_holding(rig: ArmRig, braking: bool) -> None:
    if braking:
        rig.execute(PAN)
        rig.run(1.0)
    rig.alive = False
    if braking:
        rig.run(2.0)
    else:
        rig.until_mode(Mode.MOVING)
        rig.run(0.5)
    rig.alive = True
    rig.until_mode(Mode.HOLDING)
    if braking:
        assert rig.outcomes == [Outcome.STOPPED]
    rig.run(6.0)
    assert rig.mode is Mode.HOLDING
    assert distance_to_rest(rig) > 0.3


# What is asked of the arm after a stop, before its server is lost; and True if it then parks.
SINCE_A_STOP: dict[str, tuple[tuple[Any, ...], bool]] = {
    "nothing": ((), False),
    "a motion that is refused": ((Execute(1, smooth_move({"gripper": (0.5, 0.0)}, 1.0), epoch=2),), False),
    "a motion": ((Execute(1, smooth_move({"gripper": (0.0, 0.009)}, 1.0), epoch=2),), True),
    "to hold": ((Command(1, Order.ENABLE, epoch=2),), True),
}


@pytest.mark.parametrize(("asked", "parks"), SINCE_A_STOP.values(), ids=SINCE_A_STOP)
@pytest.mark.parametrize("lost", [True, False], ids=["server gone", "server silent"])
def test_an_arm_that_was_stopped_and_asked_for_nothing_since_holds_without_its_server(
    rig: ArmRig, asked: tuple[Any, ...], parks: bool, lost: bool
) -> None:
    rig.supervisor.handle(Stop(epoch=2))
    for each in asked:
        rig.supervisor.handle(each)
        rig.run(1.5)
    if lost:
        lose_server(rig)
        until_ended(rig)
    else:
        rig.alive = False
        rig.run(12.0)
    assert rig.torque() == [0 if parks else 1] * 6
    assert (distance_to_rest(rig) < SINK_RAD) == parks


@pytest.mark.parametrize("stopped", [True, False])
def test_an_arm_process_in_place_of_another_that_was_stopped_holds_without_its_server(stopped: bool) -> None:
    emulator = ArmRig().started().emulator
    settings = {"on_server_lost": EndState.PARK, "start_enabled": False, "last_stop": 2, "stopped": stopped}
    rig = ArmRig(emulator, **settings)
    rig.until_mode(Mode.HOLDING)
    rig.supervisor.handle(KeepParking(way_to_rest()))
    lose_server(rig)
    until_ended(rig)
    assert rig.torque() == [int(stopped)] * 6


def test_an_arm_that_holds_after_an_emergency_stop_holds_without_its_server() -> None:
    rig = ArmRig(on_server_lost=EndState.PARK, on_emergency_stop=EmergencyPolicy.HOLD).started()
    rig.supervisor.handle(Command(1, Order.EMERGENCY_STOP, epoch=2))
    rig.wait(1)
    lose_server(rig)
    until_ended(rig)
    assert rig.torque() == [1] * 6


def test_a_relaxed_arm_is_not_parked(rig: ArmRig, caplog: pytest.LogCaptureFixture) -> None:
    assert rig.order(Order.RELAX).done
    rig.alive = False
    rig.run(6.0)
    lose_server(rig)
    until_ended(rig, 0.1)
    assert (rig.outcomes, "parking" in caplog.text) == ([], False)
