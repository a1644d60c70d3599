"""Plant of a servo: motor and gear under external loads, and the motor's temperature. Pure: time is passed in."""

import math
from dataclasses import dataclass

NO_LOAD_TICKS_S = 2867.0  # STS3215 C001 without load at 6 V: 0.238 s per 60 deg

STALL_CURRENT_A = 2.4

SUBSTEP_S = 0.002  # fast enough for the stiffest position gain to stay stable
MAX_STEP_S = 0.1  # a process that was suspended does not catch up
REST_TICKS_S = 1e-3  # a slower joint counts as at rest: this is a tick in a quarter of an hour

# Duty that a position error of one tick calls for, per unit of the P gain: the factory's gain of 32 follows
# with a lag of 20 ms and stalls at 5 deg, lerobot's 16 with twice that.
DUTY_PERMILLE_PER_TICK_AND_GAIN = 0.5

# A relaxed gear of 1:345 hardly turns under the weight of the arm: 5 ticks/s (0.4 deg/s) at the shoulder.
DROOP_TICKS_S_PER_PERMILLE = 0.08

# A hand turns a free joint with ease: a push like half the motor's torque makes a turn in four seconds.
PUSH_TICKS_S_PER_PERMILLE = 2.0

HAND_TICKS_S = 1500.0  # speed of a joint moved by hand, 130 deg/s

AMBIENT_C = 32.0


@dataclass(frozen=True)
class Heating:
    """Heat of a motor."""

    kelvin: float  # final warming at a current of 1 A [K]
    exponent: float  # power of the current [A] to which the final warming is proportional
    warming_s: float  # time constant of warming [s]
    cooling_s: float  # time constant of cooling [s]


# A held stretched arm (0.2 A) grows warm, a stalled motor (2.4 A) gains half a degree each second; a motor in its
# plastic housing takes ten minutes to most of its temperature.
WELL_COOLED = Heating(kelvin=60.0, exponent=2.0, warming_s=600.0, cooling_s=600.0)

# A gripper that squeezes at a quarter to half of its torque was seen at 50 degC after a minute to half a minute, and
# to burn later (phosphobot, issue 241): a line through both.
SQUEEZING = Heating(kelvin=95.0, exponent=1.0, warming_s=150.0, cooling_s=600.0)


@dataclass(frozen=True)
class Drive:
    """Command of the registers to the motor."""

    goal_ticks: float  # goal position
    velocity_ticks_s: float  # velocity limit of the profile
    acceleration_ticks_s2: float  # acceleration limit of the profile
    torque_permille: float  # largest duty [0.1 %]; 0 leaves the joint free
    p_gain: int  # register P_GAIN


@dataclass
class Plant:
    """Joint driven by one servo."""

    position_ticks: float  # position, as the encoder counts
    lower_stop_ticks: float  # mechanical end
    upper_stop_ticks: float  # mechanical end
    gravity_permille: float = 0.0  # duty that balances the joint's weight; with less the joint sinks against its sign
    push_permille: float = 0.0  # external push, as the motor duty of the same force
    # Position to which a hand, stronger than the motor, moves the joint; None for no hand.
    hand_ticks: float | None = None
    velocity_ticks_s: float = 0.0  # velocity
    duty_permille: float = 0.0  # motor duty [0.1 %]

    def __post_init__(self) -> None:
        self._profile_ticks = self.position_ticks
        self._profile_velocity_ticks_s = 0.0
        self.walls_ticks = (self.lower_stop_ticks, self.upper_stop_ticks)  # mechanical ends, or an obstacle before one
        self.at_rest = False  # True if it did not move in the latest step, and will not until something changes
        self._rested_under: tuple[object, ...] = ()

    @property
    def current_a(self) -> float:
        """Motor current [A], driven by the duty against the back-EMF of the turning motor."""
        return (self.duty_permille / 1000.0 - self.velocity_ticks_s / NO_LOAD_TICKS_S) * STALL_CURRENT_A

    def block(self, obstacle_ticks: float | None) -> None:
        """Put an obstacle at a tick, above or below the present position; None removes it."""
        lower, upper = self.lower_stop_ticks, self.upper_stop_ticks
        if obstacle_ticks is None:
            self.walls_ticks = (lower, upper)
        elif obstacle_ticks >= self.position_ticks:
            self.walls_ticks = (lower, min(upper, obstacle_ticks))
        else:
            self.walls_ticks = (max(lower, obstacle_ticks), upper)

    def step(self, duration_s: float, drive: Drive) -> None:
        # Everything that can move the joint; while it is unchanged a joint at rest stays so, and costs nothing.
        under = (
            drive,
            self.position_ticks,
            self.gravity_permille,
            self.push_permille,
            self.hand_ticks,
            self.walls_ticks,
        )
        if self.at_rest and under == self._rested_under:
            return
        remaining_s = min(duration_s, MAX_STEP_S)
        while remaining_s > 0.0:
            dt_s = min(remaining_s, SUBSTEP_S)
            remaining_s -= dt_s
            self._substep(dt_s, drive)
        settled = drive.torque_permille == 0.0 or self._profile_ticks == drive.goal_ticks
        self.at_rest = settled and self._profile_velocity_ticks_s == 0.0 and abs(self.velocity_ticks_s) < REST_TICKS_S
        self._rested_under = (drive, self.position_ticks, *under[2:])

    def drive_motor(self, dt_s: float, drive: Drive) -> None:
        """Advance the profile by ``dt_s`` [s], and set the duty."""
        if drive.torque_permille > 0.0:
            self._advance_profile(dt_s, drive)
            stiffness = DUTY_PERMILLE_PER_TICK_AND_GAIN * drive.p_gain
            duty = stiffness * (self._profile_ticks - self.position_ticks)
            self.duty_permille = max(-drive.torque_permille, min(drive.torque_permille, duty))
        else:
            self._profile_ticks, self._profile_velocity_ticks_s = self.position_ticks, 0.0
            self.duty_permille = 0.0

    def _substep(self, dt_s: float, drive: Drive) -> None:
        self.drive_motor(dt_s, drive)
        if drive.torque_permille > 0.0:
            load = self.gravity_permille - self.push_permille
            velocity = (self.duty_permille - load) / 1000.0 * NO_LOAD_TICKS_S
        else:
            velocity = (
                self.push_permille * PUSH_TICKS_S_PER_PERMILLE - self.gravity_permille * DROOP_TICKS_S_PER_PERMILLE
            )
        if self.hand_ticks is not None:
            velocity = max(-HAND_TICKS_S, min(HAND_TICKS_S, (self.hand_ticks - self.position_ticks) / dt_s))
        wanted = self.position_ticks + velocity * dt_s
        lower, upper = self.walls_ticks
        reached = max(lower, min(upper, wanted))
        self.velocity_ticks_s = velocity if reached == wanted else 0.0
        self.position_ticks = reached

    def _advance_profile(self, dt_s: float, drive: Drive) -> None:
        distance = drive.goal_ticks - self._profile_ticks
        speed = min(drive.velocity_ticks_s, math.sqrt(2.0 * drive.acceleration_ticks_s2 * abs(distance)))
        change = math.copysign(speed, distance) - self._profile_velocity_ticks_s
        most = drive.acceleration_ticks_s2 * dt_s
        velocity = self._profile_velocity_ticks_s + max(-most, min(most, change))
        if abs(distance) <= abs(velocity) * dt_s and abs(velocity) <= 2.0 * most:
            self._profile_ticks, self._profile_velocity_ticks_s = drive.goal_ticks, 0.0
            return
        self._profile_ticks += velocity * dt_s
        self._profile_velocity_ticks_s = velocity


RELAXED = Drive(0.0, 0.0, 0.0, 0.0, 0)


@dataclass
class DrivenPlant(Plant):
    """Joint that a physical world moves (:mod:`robot.physics`), by the drive that the servo set last."""

    drive: Drive = RELAXED

    def step(self, duration_s: float, drive: Drive) -> None:  # noqa: ARG002 - the world's time passes for all joints
        self.drive = drive


@dataclass
class Motor:
    """Motor temperature: heated by the current, cooled by the air."""

    temperature_c: float = AMBIENT_C  # temperature of the housing [degC]
    rate: float = 1.0  # factor by which it warms and cools faster than a real one
    heating: Heating = WELL_COOLED  # heat of the real motor

    def step(self, duration_s: float, current_a: float) -> None:
        heating = self.heating
        target_c = AMBIENT_C + heating.kelvin * abs(current_a) ** heating.exponent
        constant_s = heating.warming_s if target_c > self.temperature_c else heating.cooling_s
        self.temperature_c += (target_c - self.temperature_c) * min(1.0, duration_s * self.rate / constant_s)
