"""A simulated arm whose time stands still: a slow clock for motions and orders, and no obstacle to a stop or an end."""

from functools import cached_property

import pytest

from robot.control.loop import hardware_opener
from robot.control.pacing import Pacer, SimulationClock
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmState, Execute, Mode, Order, Outcome, PauseSimulation, Shutdown, Stop
from robot.physics.bodies import Body, BodyShape, SetBodies
from robot.trajectory import PERIOD_S
from tests.helpers.arm_rig import CALIBRATION, STEPS_A_TICK, ArmRig
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.motions import smooth_move

PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=1.5)


class Simulation(ArmRig):
    """The supervisor of a simulated arm, on its own clock and the machine's."""

    def __init__(self, *, physics: bool = False) -> None:
        self.machine_s = 100.0
        emulator = SteppedEmulator(wire_time=False)
        emulator.clock = SimulationClock(self.machine_s)
        super().__init__(emulator, hardware=EmulatedConfig(CALIBRATION, driven=True, physics=physics))
        self.started()

    @cached_property
    def _hardware(self):
        return hardware_opener(self.config, self.clock)

    def tick(self, ticks: int = 1, *, server_gone: bool = False) -> None:
        pacer = Pacer(self.machine_s)
        for _ in range(ticks):
            for _ in range(STEPS_A_TICK):
                if self.supervisor.work() > 0.0:
                    break
            self.machine_s += PERIOD_S
            self.clock.start_tick(self.machine_s)
            self.supervisor.tick(pacer, server_gone=server_gone)

    def pause(self, ticks: int = 0, *, paused: bool = True) -> None:
        self.supervisor.handle(PauseSimulation(paused=paused, ticks=ticks))

    @property
    def pan_rad(self) -> float:
        return float(self.state.position_rad[0])


def paused_in_motion(*, physics: bool = False) -> Simulation:
    simulation = Simulation(physics=physics)
    simulation.execute(PAN)
    simulation.tick(50)
    simulation.pause()
    simulation.tick(2)
    assert simulation.mode is Mode.MOVING
    return simulation


@pytest.fixture
def moving() -> Simulation:
    return paused_in_motion()


def test_a_motion_stands_still_goes_on_tick_by_tick_and_ends_well_later() -> None:
    moving = paused_in_motion(physics=True)
    level = (0.0, 0.0, 0.0, 1.0)
    cube = Body("cube", (BodyShape("box", (0.01, 0.01, 0.01), (0.0, 0.0, 0.0), level),), (0.3, 0.3, 0.1), level, True)
    moving.supervisor.handle(SetBodies(3, (cube,)))
    moving.tick(3)
    assert [state.bodies.version for state in moving.sent if isinstance(state, ArmState) and state.bodies] == [3]
    world, clock_s = moving.supervisor.arm.hardware.world, moving.clock()
    before = world.data.qpos.tolist()
    moving.tick(200)
    assert (moving.clock(), world.data.qpos.tolist()) == (clock_s, before)
    # Bodies at rest are sent once a second.
    assert sum(state.bodies is not None for state in moving.sent if isinstance(state, ArmState)) == 3
    assert (moving.state.stepped_ticks, moving.state.fault) == (0, None)
    moving.pause(ticks=3)
    moving.tick(20)
    assert moving.clock() == pytest.approx(clock_s + 3 * PERIOD_S)
    assert (moving.state.stepped_ticks, moving.state.clock_s) == (3, moving.clock())
    assert world.data.qpos.tolist() != before
    moving.pause(paused=False)
    moving.tick(200)
    assert (moving.state.stepped_ticks, moving.outcomes) == (None, [Outcome.REACHED])
    assert moving.pan_rad == pytest.approx(1.0, abs=0.02)


def test_a_goal_that_comes_meanwhile_begins_when_time_passes_again() -> None:
    simulation = Simulation()
    simulation.pause()
    simulation.execute(PAN)
    simulation.tick(200)
    assert simulation.pan_rad == pytest.approx(0.0, abs=0.01)
    simulation.pause(paused=False)
    simulation.tick(300)
    assert simulation.outcomes == [Outcome.REACHED]


def test_a_stop_meanwhile_brakes_as_soon_as_time_passes_and_no_older_motion_begins(moving: Simulation) -> None:
    moving.supervisor.handle(Stop(epoch=5))
    moving.supervisor.handle(Execute(2, PAN, epoch=4))
    moving.tick(100)
    assert moving.outcomes == [Outcome.STOPPED]
    moving.pause(ticks=50)
    moving.tick(60)
    assert moving.outcomes == [Outcome.STOPPED] * 2
    assert moving.pan_rad < 0.5


def test_an_emergency_stop_meanwhile_cuts_torque_and_is_answered_at_once(moving: Simulation) -> None:
    number = moving.begin(Order.EMERGENCY_STOP)
    moving.tick(10)
    assert moving.answer(number).message == "torque is off at every servo"
    assert (moving.mode, moving.clock.stepped_ticks) == (Mode.FAULT, 0)


def test_another_order_meanwhile_is_done_when_time_passes_again(moving: Simulation) -> None:
    number = moving.begin(Order.RELAX)
    moving.tick(200)
    assert moving.answer(number) is None
    moving.pause(paused=False)
    assert moving.wait(number).message == "the arm is relaxed"


@pytest.mark.parametrize("server_gone", [False, True])
def test_the_end_of_the_server_ends_the_pause(moving: Simulation, server_gone: bool) -> None:
    if not server_gone:
        moving.supervisor.handle(Shutdown())
    for _ in range(300):
        moving.tick(server_gone=server_gone)
        if moving.supervisor.finished():
            break
    assert moving.supervisor.finished()
    assert moving.pan_rad < 0.5


def test_hardware_that_is_lost_is_checked_again_in_time_that_passes(moving: Simulation) -> None:
    moving.supervisor.disconnect("serial port was lost")
    moving.connect()
    moving.tick(100)
    assert (moving.clock.stepped_ticks, moving.mode) == (None, Mode.HOLDING)
