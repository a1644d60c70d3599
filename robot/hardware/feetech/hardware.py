"""Feetech servos as the controller's hardware: radians and shares above, ticks and registers below."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from robot.calibration import Calibration
from robot.errors import StartupError
from robot.faults import Fault
from robot.guard_limits import GuardLimits
from robot.hardware.config import FeetechConfig
from robot.hardware.feetech import torque
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.discovery import resolve_port
from robot.hardware.feetech.register_checks import RegisterChecks
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    GOAL_ADDRESS,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    encode,
    parse_control,
)
from robot.hardware.feetech.servo_map import PERMILLE, ServoMap
from robot.hardware.feetech.survey import ServoFound, read_control, survey
from robot.hardware.feetech.telemetry import ServoWatch
from robot.hardware.feetech.torque import TickLimits
from robot.hardware.interface import Condition, Flags, HardwareInterface, Measured, Survey
from robot.hardware.steps import Steps
from robot.limits import JointBounds
from robot.trajectory import Vector


class FeetechHardware(HardwareInterface):
    """Servos of one arm on an open bus.

    Args:
        bus: the bus, which this closes.
        calibration: joints, whose order is that of every array, and their servos.
        bounds: soft limits of the joints.
        guard_limits: how hard the servos may push.
        clock: time of the control loop [s].
        simulated: whether the servos are emulated, with no cable or supply to look after.

    Attributes:
        bus: as given.
        servos: joints and servos side by side.
    """

    def __init__(
        self,
        bus: Bus,
        calibration: Calibration,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
        *,
        simulated: bool = False,
    ) -> None:
        self.bus = bus
        self.servos = ServoMap(calibration, bounds, guard_limits)
        super().__init__(self.servos.names, self.servos.full_torque / PERMILLE)
        self.counters = bus.counters
        self._calibration = calibration
        self._bounds = bounds
        self._clock = clock
        self._simulated = simulated
        self._watch = ServoWatch(self.servos)
        self._found: dict[int, ServoFound] = {}
        self._checks = RegisterChecks(self.servos, self._found)
        self._limits = TickLimits({}, {})
        self._goal_rad: list[float] = []
        self._goal_blocks: dict[int, bytes] = {}
        self._share: list[float] = []
        self._share_permille: dict[int, int] = {}

    def survey(self) -> Steps[Survey]:
        """Find the servos; see :meth:`HardwareInterface.survey`."""
        self._found.update((yield from survey(self.bus, self.servos, simulated=self._simulated)))
        found = [self._found[servo] for servo in self.servos.ids]
        own_limits = {servo: each.angle_limits_ticks for servo, each in self._found.items()}
        bounds = self._bounds.within_servos(self._calibration, own_limits)
        self._limits = TickLimits(self.servos.ticks_range(bounds), own_limits)
        driven = np.array([each.control.torque_on for each in found])
        goal_rad = self.servos.positions_rad([each.control.goal_ticks for each in found])
        return Survey(
            bounds=bounds,
            driven=driven,
            goal_rad=np.where(driven, goal_rad, np.nan),
            max_voltage_v=np.array([each.max_voltage_v for each in found]),
        )

    def read(self) -> Measured | None:
        """Read the servos' telemetry in one transaction; silent ones are asked less often."""
        asked = self._watch.ids_to_ask()
        if asked:
            started_s = self._clock()
            frames = self.bus.sync_read(asked, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
            self.round_trips_s.append(self._clock() - started_s)
            self._watch.take(asked, frames, started_s)
        return self._watch.measured(self._clock(), time.time()) if self._watch.complete else None

    def write_goals(self, goal_rad: Vector) -> None:
        """Write the goals, also while the arm rests: a servo may have missed them."""
        goals = goal_rad.tolist()
        if goals != self._goal_rad:
            self._goal_rad, self._goal_blocks = goals, self.servos.goal_blocks(goal_rad)
        self.bus.sync_write(GOAL_ADDRESS, self._goal_blocks)

    def write_torque_shares(self, torque_share: Vector) -> None:
        """Write the torque limits that servos have not been told yet."""
        changed = self._checks.limits_to_write(self._permille(torque_share))
        if changed:
            data = {servo: encode(Register.TORQUE_LIMIT, limit) for servo, limit in changed.items()}
            self.bus.sync_write(Register.TORQUE_LIMIT, data)

    def check(self, stamp_s: float) -> Fault | None:
        """Read back the registers of the servo whose turn it is."""
        servo = self._checks.due()
        if servo is None or self._watch.is_silent(servo):
            return None
        frame = self.bus.sync_read((servo,), CONTROL_ADDRESS, CONTROL_BYTES).get(servo)
        return None if frame is None else self._checks.judge(servo, parse_control(frame.data), stamp_s)

    def driven(self) -> Steps[Flags]:
        """Read every servo's TORQUE_ENABLE."""
        driven = np.zeros(len(self.servos.ids), dtype=bool)
        for joint, servo in enumerate(self.servos.ids):
            driven[joint] = (yield from read_control(self.bus, servo)).torque_on
        return driven

    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        """Switch torque on; see :mod:`robot.hardware.feetech.torque`."""
        goals = yield from torque.enable(self.bus, self.servos, self._limits, self._ids(joints))
        self._checks.told(torque.full_torque(self.servos))
        return self.servos.rad_from_ticks(goals)

    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Lower the torque limits, then switch torque off."""
        return self._labels((yield from torque.relax(self.bus, self.servos, self._permille(torque_share))))

    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        """Switch torque off servo by servo."""
        ids = list(self.servos.ids) if joints is None else self._ids(joints)
        return self._labels((yield from torque.switch_off(self.bus, ids)))

    def cut_torque(self) -> Steps[list[str]]:
        """Broadcast torque off, then look servo by servo."""
        return self._labels((yield from torque.emergency_stop(self.bus, self.servos)))

    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        """Switch torque off and on again; a firmware whose latch that does not clear needs a power cycle."""
        overloaded = self._ids(joints)
        for servo in overloaded:
            yield from torque.clear_overload(self.bus, self.servos, self._limits, servo)
            if not hold and (yield from torque.switch_off(self.bus, [servo])):
                raise StartupError(f"torque off could not be verified at {self.servos.label(servo)}")
        if not hold or not overloaded:
            return None
        goals = {}
        for servo in self.servos.ids:
            goals[servo] = (yield from read_control(self.bus, servo)).goal_ticks
        self._checks.told(torque.full_torque(self.servos))
        return self.servos.rad_from_ticks(goals)

    def condition(self, joint: int) -> Condition:
        """Condition of one servo."""
        servo = self.servos.ids[joint]
        return Condition(
            hardware_id=f"servo {servo}",
            torque_enabled=self._checks.torque_on.get(servo),
            age_s=self._watch.age_s(servo, self._clock()),
            silent_cycles=self._watch.silent_cycles[servo],
            warnings=self._found[servo].warnings if servo in self._found else (),
        )

    def label(self, joint: int) -> str:
        """Name a joint and its servo's id."""
        return self.servos.label(self.servos.ids[joint])

    def close(self) -> None:
        """Close the bus; the servos keep doing what they were told."""
        self.bus.close()

    def _ids(self, joints: Sequence[int]) -> list[int]:
        return [self.servos.ids[joint] for joint in joints]

    def _labels(self, servo_ids: Sequence[int]) -> list[str]:
        return [self.servos.label(servo) for servo in servo_ids]

    def _permille(self, torque_share: Vector) -> dict[int, int]:
        """Register TORQUE_LIMIT by servo id; the same object while the shares are the same, which is nearly always."""
        share = torque_share.tolist()
        if share != self._share:
            limits = zip(self.servos.ids, share, strict=True)
            self._share, self._share_permille = share, {servo: round(limit * PERMILLE) for servo, limit in limits}
        return self._share_permille


class SerialServos:
    """Servos of an arm, wherever their adapter is plugged in.

    Args:
        config: port and calibration.
        bounds: soft limits of the joints.
        guard_limits: how hard the servos may push.
        clock: time of the control loop [s].
    """

    def __init__(
        self, config: FeetechConfig, bounds: JointBounds, guard_limits: GuardLimits, clock: Callable[[], float]
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock

    def open(self) -> HardwareInterface:
        """Open the port; see :func:`robot.hardware.feetech.port.open_port` for the errors."""
        bus = Bus.open(resolve_port(self._config.port))
        return FeetechHardware(bus, self._config.calibration, self._bounds, self._guard_limits, self._clock)
