"""Every program in examples/ does with the simulated arm what it says."""

from __future__ import annotations

import signal
import subprocess
import sys

from websockets.sync.client import connect

from tests.examples.conftest import EXAMPLES, RunExample
from tests.helpers.blocking import call_on
from tests.helpers.server import RunningServer

SCREEN_LINES = 100


def test_a_named_goal_is_reached_and_told(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("named_goal.py", "ready", str(server.port))
    assert (done.returncode, done.stdout) == (0, "1 the arm is there\n"), done.stderr


def test_a_named_goal_that_does_not_exist_ends_with_1(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("named_goal.py", "raedy", str(server.port))
    assert done.returncode == 1
    assert done.stdout.startswith("-16 ")


def test_joints_are_turned_while_their_way_is_told(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("joint_goal.py", str(server.port), "shoulder_pan=10")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "executing" in done.stdout
    assert done.stdout.splitlines()[-1] == "done       100%  the arm is there"


def test_a_point_out_of_reach_becomes_the_nearest_one(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("pose_goal.py", "1", "0", "0.2", str(server.port))
    assert done.returncode == 0, done.stdout + done.stderr
    refusal, success = done.stdout.splitlines()
    assert "cannot reach" in refusal
    assert success == "the arm is there"


def test_a_square_is_drawn_in_the_air(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("square_in_the_air.py", str(server.port))
    assert (done.returncode, done.stdout) == (0, "a square of 6 cm, 100% of it\n"), done.stderr


def test_a_box_is_picked_up_and_put_down(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("pick_and_place.py", str(server.port))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["the box is held", "the box stands in its new place"]


def test_the_wave_goes_on_until_ctrl_c_and_leaves_the_arm_standing(server: RunningServer) -> None:
    command = [sys.executable, str(EXAMPLES / "classroom_wave.py"), str(server.port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as wave:
        assert wave.stdout is not None
        lines = [wave.stdout.readline() for _ in range(2)]
        wave.send_signal(signal.SIGINT)
        rest, _ = wave.communicate(timeout=20)
    assert lines == ["there\n", "there\n"]
    assert wave.returncode == 0
    assert rest.splitlines()[-1] == "the arm does not move"


def test_the_wave_tells_why_it_may_not_move_the_arm(server: RunningServer) -> None:
    command = [sys.executable, str(EXAMPLES / "classroom_wave.py"), str(server.port)]
    with connect(server.url) as other, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as wave:
        assert call_on(other, "/arm/take_control")["success"]
        assert wave.stdout is not None
        sentence, name = wave.stdout.readline(), wave.stdout.readline()
        wave.send_signal(signal.SIGINT)
        wave.communicate(timeout=20)
    assert "has controlled the arm since" in sentence
    assert name == "FAILURE\n"


def test_every_example_fits_on_a_screen() -> None:
    programs = [path for path in EXAMPLES.iterdir() if path.suffix in (".py", ".html")]
    too_long = [path.name for path in programs if len(path.read_text().splitlines()) > SCREEN_LINES]
    assert programs
    assert not too_long
