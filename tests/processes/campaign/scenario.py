"""Scenario of one run of the campaign, drawn from its seed, and the result of the run."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from robot.calibration import Calibration
from robot.description.robot_folder import built_in
from robot.emulator.populations import POPULATIONS, SUPPLY_V, Population
from robot.messages import EmergencyPolicy, EndState, Order

CALIBRATION = replace(Calibration.nominal(built_in("so101").hardware.servos), measured=True, offsets_known=True)
JOINTS = CALIBRATION.joints
NAMES = [joint.joint for joint in JOINTS]

# Far from each other, so that one servo's position cannot be taken for another's, and clear of the ends.
START_RAD = (0.3, -0.7, 0.6, 0.1, -0.4, 0.8)

# Every motion ends so near to the start pose at most [rad].
REACH_RAD = 0.5

# Duration of the motions, and the first and last time at which an incident starts [s].
MOVING_S = 3.0
FIRST_EVENT_S = 0.4
LAST_EVENT_S = 1.8

# Kinds of faults on the wire, and the rates that are drawn for them.
WIRE_FAULTS = ("drop", "corrupt", "wrong_id", "truncate", "duplicate", "noise", "delay", "lose_instruction")
RATES = (0.01, 0.05)


class Happening(Enum):
    """Incident in a run, besides faults on the wire."""

    NOTHING = "wire faults only"
    SERVO_OFFLINE = "servo offline"
    UNPLUG = "unplug"
    UNPLUG_RENAMED = "unplug, back under another name"
    FROZEN = "adapter hangs"
    POWER_CYCLE_ONE = "power cycle of one servo"
    POWER_CYCLE_ALL = "power cycle of all"
    OBSTACLE = "obstacle"
    PUSH = "push"
    HAND = "hand moves a joint"
    OVER_TEMPERATURE = "over-temperature"
    UNDERVOLTAGE = "undervoltage"
    TORQUE_OFF = "torque off behind the driver's back"
    ENCODER_JUMP = "encoder jump"
    EMERGENCY_STOP = "emergency stop"
    RELAX = "relax"
    ARM_KILLED = "arm process killed"


# Servos that must never be given torque: their zero has shifted, or they cannot be told apart.
REFUSED = frozenset({"ros2_driver", "kit"})


@dataclass(frozen=True)
class Event:
    """One event and its time.

    Attributes:
        at_s: since the first motion began [s].
        command: live command to the emulator; empty for none.
        order: order to the arm; None for no order.
        kills_arm: True if the arm process gets SIGKILL.
    """

    at_s: float
    command: Mapping[str, object] = field(default_factory=dict)
    order: Order | None = None
    kills_arm: bool = False


@dataclass(frozen=True)
class Scenario:
    """One run.

    Attributes:
        wire: probabilities of faults on the wire.
        population: state in which the servos are found.
        calmed: True if all faults end, and the arm must recover, before the arm process is ended.
    """

    seed: int
    happening: Happening
    wire: Mapping[str, float]
    events: tuple[Event, ...]
    on_exit: EndState
    on_server_lost: EndState
    on_emergency_stop: EmergencyPolicy
    calmed: bool
    population: str

    @property
    def servos(self) -> Population:
        """State in which the servos are found."""
        return POPULATIONS[self.population]


def scenario_of(seed: int, population: str | None = None) -> Scenario:
    """Return the scenario of a seed, which may draw the servos; successive seeds take the incidents in turn."""
    chance = random.Random(seed)
    happening = list(Happening)[seed % len(Happening)]
    return Scenario(
        seed=seed,
        happening=happening,
        wire=_wire(chance, at_least_one=happening is Happening.NOTHING),
        events=_events(happening, chance),
        on_exit=chance.choice((EndState.HOLD, EndState.RELAX)),
        on_server_lost=chance.choice((EndState.HOLD, EndState.RELAX)),
        on_emergency_stop=chance.choice(list(EmergencyPolicy)),
        calmed=chance.random() < 0.6,
        # The last draw: the rest of a seed's scenario is the same on every population.
        population=population or chance.choice(list(POPULATIONS)),
    )


def random_goal(chance: random.Random) -> dict[str, float]:
    """Draw a pose of some joints near the start pose [rad]."""
    chosen = chance.sample(range(len(JOINTS)), chance.randint(1, len(JOINTS)))
    return {JOINTS[joint].joint: START_RAD[joint] + chance.uniform(-REACH_RAD, REACH_RAD) for joint in chosen}


def _wire(chance: random.Random, *, at_least_one: bool) -> dict[str, float]:
    """Draw the rates of the faults on the wire: of none, one, or several at once."""
    count = chance.choice((0, 1, 1, 2, 3))
    names = chance.sample(WIRE_FAULTS, max(count, int(at_least_one)))
    return {name: chance.choice(RATES) for name in names}


def _events(happening: Happening, chance: random.Random) -> tuple[Event, ...]:
    at_s = chance.uniform(FIRST_EVENT_S, LAST_EVENT_S)
    until_s = at_s + chance.uniform(0.05, 1.2)
    commands = _commands(happening, chance.randrange(len(JOINTS)), chance)
    if commands is not None:
        return Event(at_s, commands[0]), Event(until_s, commands[1])
    if happening is Happening.EMERGENCY_STOP:
        return (Event(at_s, order=Order.EMERGENCY_STOP),)
    if happening is Happening.RELAX:
        return (Event(at_s, order=Order.RELAX),)
    return (Event(at_s, kills_arm=True),) if happening is Happening.ARM_KILLED else ()


def _ticks_near(servo: int, away_rad: float) -> int:
    """Return a tick at a distance from the start pose, inside the joint's range."""
    lower, upper = CALIBRATION.joints[servo].servo.lower_rad, CALIBRATION.joints[servo].servo.upper_rad
    return JOINTS[servo].ticks_from_rad(max(lower, min(upper, START_RAD[servo] + away_rad)))


def _commands(
    happening: Happening, servo: int, chance: random.Random
) -> tuple[dict[str, object], dict[str, object]] | None:
    """Return the commands to the emulator that begin and end an incident; None for one without any."""
    joint = JOINTS[servo].joint
    match happening:
        case Happening.SERVO_OFFLINE:
            return {"offline": [joint]}, {"online": [joint]}
        case Happening.UNPLUG:
            return {"plugged": False}, {"plugged": True}
        case Happening.UNPLUG_RENAMED:
            return {"plugged": False}, {"plugged": "renamed"}
        case Happening.FROZEN:
            return {"frozen": True}, {"frozen": False}
        case Happening.POWER_CYCLE_ONE:
            return {"power_cycle": [joint]}, {}
        case Happening.POWER_CYCLE_ALL:
            return {"power_cycle": NAMES}, {}
        case Happening.OBSTACLE:
            return {"obstacle": {joint: _ticks_near(servo, chance.uniform(-0.2, 0.2))}}, {"obstacle": {joint: None}}
        case Happening.PUSH:
            return {"push": {joint: chance.choice((-700, 300, 700))}}, {"push": {joint: 0}}
        case Happening.HAND:
            return {"hand": {joint: _ticks_near(servo, chance.uniform(-0.5, 0.5))}}, {"hand": {joint: None}}
        case Happening.OVER_TEMPERATURE:
            return {"temperature": {joint: chance.choice((58, 62, 67))}}, {"temperature": {joint: 40}}
        case Happening.UNDERVOLTAGE:
            return {"supply": 4.2}, {"supply": SUPPLY_V}
        case Happening.TORQUE_OFF:
            return {"torque_off": [joint]}, {}
        case Happening.ENCODER_JUMP:
            return {"jump": {joint: 400}}, {"jump": {joint: 0}}
    return None


def calm(population: Population) -> tuple[Mapping[str, object], ...]:
    """Return the commands that end every fault that a scenario may have started."""
    return (
        dict.fromkeys(WIRE_FAULTS, 0.0),
        {"online": NAMES, "frozen": False, "plugged": True, "supply": population.supply_v},
        {name: dict.fromkeys(NAMES) for name in ("obstacle", "hand")},
        {"push": dict.fromkeys(NAMES, 0)},
        {"temperature": dict.fromkeys(NAMES, 40)},
    )


@dataclass
class Result:
    """One run: one sentence a violation, none in a good run, and the numbers of writes and states that were checked."""

    seed: int
    happening: str
    population: str
    violations: list[str] = field(default_factory=list)
    writes: int = 0
    states: int = 0
