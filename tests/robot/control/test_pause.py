"""A simulated arm whose time stands still: a slow clock for motions and orders, and no obstacle to a stop or an end."""

import pytest

from robot.control.loop import hardware_opener
from robot.control.pacing import PERIOD_S, Pacer, Scheduling, SimulationClock
from robot.control.supervisor import Supervisor
from robot.hardware.config import EmulatedConfig
from robot.messages import (
    ArmConfig,
    ArmState,
    Command,
    CommandDone,
    Execute,
    Mode,
    MotionEnded,
    Order,
    Outcome,
    PauseSimulation,
    Shutdown,
    Stop,
)
from robot.physics.world import World
from tests.helpers.arm_rig import CALIBRATION, ROBOT
from tests.helpers.motions import smooth_move

PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=1.5)


class Simulation:
    """The supervisor of a simulated arm, on its own clock and the machine's."""

    def __init__(self, *, physics: bool = False) -> None:
        self.machine_s = 100.0
        self.clock = SimulationClock(self.machine_s)
        config = ArmConfig(ROBOT, EmulatedConfig(CALIBRATION, driven=True, physics=physics))
        self.sent: list[object] = []
        self.supervisor = Supervisor(config, lambda message, _: self.sent.append(message), self.clock, Scheduling())
        self.open = hardware_opener(config, self.clock)
        self.supervisor.connect(self.open())
        while self.supervisor.mode is not Mode.HOLDING:
            self.tick()

    def tick(self, ticks: int = 1, *, server_gone: bool = False) -> None:
        pacer = Pacer(self.machine_s)
        for _ in range(ticks):
            for _ in range(4):
                if self.supervisor.work() > 0.0:
                    break
            self.machine_s += PERIOD_S
            self.clock.start_tick(self.machine_s)
            self.supervisor.tick(pacer, server_gone=server_gone)

    def pause(self, ticks: int = 0) -> None:
        self.supervisor.handle(PauseSimulation(paused=True, ticks=ticks))

    def go_on(self) -> None:
        self.supervisor.handle(PauseSimulation(paused=False))

    @property
    def state(self) -> ArmState:
        return next(message for message in reversed(self.sent) if isinstance(message, ArmState))

    @property
    def pan_rad(self) -> float:
        assert self.state.position_rad is not None
        return float(self.state.position_rad[0])

    @property
    def ends(self) -> list[Outcome]:
        return [message.outcome for message in self.sent if isinstance(message, MotionEnded)]

    def order(self, order: Order) -> None:
        self.supervisor.handle(Command(1, order))

    @property
    def answers(self) -> list[str]:
        return [message.message for message in self.sent if isinstance(message, CommandDone)]


def paused_in_motion(*, physics: bool = False) -> Simulation:
    simulation = Simulation(physics=physics)
    simulation.supervisor.handle(Execute(1, PAN))
    simulation.tick(50)
    simulation.pause()
    simulation.tick(2)
    assert simulation.supervisor.mode is Mode.MOVING
    return simulation


@pytest.fixture
def moving() -> Simulation:
    return paused_in_motion()


def test_a_motion_stands_still_goes_on_tick_by_tick_and_ends_well_later() -> None:
    moving = paused_in_motion(physics=True)
    world, clock_s = world_of(moving), moving.clock()
    before = world.data.qpos.tolist()
    moving.tick(200)
    assert (moving.clock(), world.data.qpos.tolist()) == (clock_s, before)
    assert (moving.state.stepped_ticks, moving.state.fault) == (0, None)
    moving.pause(ticks=3)
    moving.tick(20)
    assert moving.clock() == pytest.approx(clock_s + 3 * PERIOD_S)
    assert (moving.state.stepped_ticks, moving.state.clock_s) == (3, moving.clock())
    assert world.data.qpos.tolist() != before
    moving.go_on()
    moving.tick(200)
    assert (moving.state.stepped_ticks, moving.ends) == (None, [Outcome.REACHED])
    assert moving.pan_rad == pytest.approx(1.0, abs=0.02)


def test_a_goal_that_comes_meanwhile_begins_when_time_passes_again() -> None:
    simulation = Simulation()
    simulation.pause()
    simulation.supervisor.handle(Execute(1, PAN))
    simulation.tick(200)
    assert simulation.pan_rad == pytest.approx(0.0, abs=0.01)
    simulation.go_on()
    simulation.tick(300)
    assert simulation.ends == [Outcome.REACHED]


def test_a_stop_meanwhile_brakes_as_soon_as_time_passes_and_no_older_motion_begins(moving: Simulation) -> None:
    moving.supervisor.handle(Stop(epoch=5))
    moving.supervisor.handle(Execute(2, PAN, epoch=4))
    moving.tick(100)
    assert moving.ends == [Outcome.STOPPED]
    moving.pause(ticks=50)
    moving.tick(60)
    assert moving.ends == [Outcome.STOPPED] * 2
    assert moving.pan_rad < 0.5


def test_an_emergency_stop_meanwhile_cuts_torque_and_is_answered_at_once(moving: Simulation) -> None:
    moving.order(Order.EMERGENCY_STOP)
    moving.tick(10)
    assert moving.answers == ["torque is off at every servo"]
    assert (moving.supervisor.mode, moving.clock.stepped_ticks) == (Mode.FAULT, 0)


def test_another_order_meanwhile_is_done_when_time_passes_again(moving: Simulation) -> None:
    moving.order(Order.RELAX)
    moving.tick(200)
    assert moving.answers == []
    moving.go_on()
    moving.tick(400)
    assert moving.answers == ["the arm is relaxed"]


@pytest.mark.parametrize("end", ["shutdown", "server gone"])
def test_the_end_of_the_server_ends_the_pause(moving: Simulation, end: str) -> None:
    if end == "shutdown":
        moving.supervisor.handle(Shutdown())
    for _ in range(300):
        moving.tick(server_gone=end == "server gone")
        if moving.supervisor.finished():
            break
    assert moving.supervisor.finished()
    assert moving.pan_rad < 0.5


def test_hardware_that_is_lost_is_checked_again_in_time_that_passes(moving: Simulation) -> None:
    moving.supervisor.disconnect("serial port was lost")
    moving.supervisor.connect(moving.open())
    moving.tick(100)
    assert (moving.clock.stepped_ticks, moving.supervisor.mode) == (None, Mode.HOLDING)


def world_of(simulation: Simulation) -> World:
    arm = simulation.supervisor.arm
    assert arm is not None
    assert arm.hardware.world is not None
    return arm.hardware.world
