"""Calibration step by step, for a terminal and a server alike: questions to a person and their consequences. Pure.

lerobot asks for the middle pose first and sets the homing offsets before the sweep from stop to stop, so that a wrong
middle pose makes a joint cross the seam between ticks 4095 and 0. Here positions are tracked across the seam, nothing
is written before the sweep is complete, and the middle of what was swept becomes the middle of the turn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from robot.calibration import MAX_TICK, RAD_PER_TICK, TICKS_PER_TURN, WIDEST_RANGE_TICKS, Calibration, JointCalibration
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError
from robot.trajectory import Vector

MIDDLE_TICK = 2047  # tick of the middle in lerobot
LEAST_SWEEP_TICKS = 500  # least range of a sweep; the smallest range of a joint, the gripper's, has 1400 ticks

# The middle of a wider range leaves no room on both sides: the register's 11 bits may put it one tick off.
WIDEST_SWEEP_TICKS = MAX_TICK - 1

# Ranges of measured arms are up to 12 deg narrower than the URDF's, a tenth of the range; a joint that covered less
# than this share has not met both stops.
STOPS_SHARE = 0.8

# A joint that covered less than this share has perhaps met one stop only: half of the missing part is the error of its
# zero, 3 deg for a joint of 200 deg. Its stops then count when it came to both twice.
CERTAIN_SHARE = 0.97

# A stop is met at the same position again, by hand within 2 deg; a hand that turns round before it is not so exact.
SAME_STOP_TICKS = 20

LEFT_STOP_TICKS = 100  # a joint has left its stop at this distance from it, 9 deg

# lerobot's format takes MIDDLE_TICK for the middle of the joint that turns freely; further off (9 deg) its zero would
# be wrong.
FREE_MIDDLE_WITHIN_TICKS = 100


class _End:
    """One end of a joint's way, and the visits to it; positions grow towards the end [ticks]."""

    def __init__(self, position: int) -> None:
        self._stop = position
        self._left = False
        self.visits = 1

    def add(self, position: int) -> None:
        if position > self._stop + SAME_STOP_TICKS or (self.visits == 1 and not self._left and position > self._stop):
            self._stop, self._left, self.visits = position, False, 1
        elif position < self._stop - LEFT_STOP_TICKS:
            self._left = True
        elif self._left and position >= self._stop - SAME_STOP_TICKS:
            self._left = False
            self.visits += 1


class Sweep:
    """Ranges covered by the servos, by servo id [ticks], tracked across the seam: positions go on beyond 0 and 4095."""

    def __init__(self, ticks: Mapping[int, int]) -> None:
        self.lowest = dict(ticks)
        self.highest = dict(ticks)
        self.present = dict(ticks)
        self.ends = {servo_id: (_End(-position), _End(position)) for servo_id, position in ticks.items()}

    def add(self, ticks: Mapping[int, int]) -> None:
        """Add positions of some servos, by id [ticks]; a joint must turn by less than half a turn between readings."""
        for servo_id, reading in ticks.items():
            half = TICKS_PER_TURN // 2
            moved = (reading - self.present[servo_id] + half) % TICKS_PER_TURN - half
            position = self.present[servo_id] + moved
            self.present[servo_id] = position
            self.lowest[servo_id] = min(self.lowest[servo_id], position)
            self.highest[servo_id] = max(self.highest[servo_id], position)
            lower_end, upper_end = self.ends[servo_id]
            lower_end.add(-position)
            upper_end.add(position)

    def width(self, servo_id: int) -> int:
        return self.highest[servo_id] - self.lowest[servo_id]


def expected_width(servo: ServoSpec) -> int:
    """Return the width of the joint's range in the URDF [ticks]."""
    return round((servo.upper_rad - servo.lower_rad) / RAD_PER_TICK)


def met_both_stops(servo: ServoSpec, width_ticks: int) -> bool:
    """Return True for a range as wide as two stops make it; a free joint has none when it covered nearly a turn."""
    if servo.turns_freely and width_ticks > WIDEST_RANGE_TICKS:
        return False
    return width_ticks >= STOPS_SHARE * expected_width(servo)


def needs_middle(servo: ServoSpec, sweep: Sweep) -> bool:
    """Return True for a joint whose middle does not follow from its sweep: it has no stops, or did not meet them."""
    return servo.turns_freely and not met_both_stops(servo, sweep.width(servo.servo_id))


def place(servo: ServoSpec, sweep: Sweep, offset: int, *, recentre: bool) -> JointCalibration:
    """Place the swept range of a joint with stops within the turn; the offset is that during the sweep [ticks]."""
    lowest, highest, width = sweep.lowest[servo.servo_id], sweep.highest[servo.servo_id], sweep.width(servo.servo_id)
    if width < LEAST_SWEEP_TICKS:
        raise CalibrationError(
            "sweep", servo.joint, f"was moved by {width} ticks only: move every joint from stop to stop"
        )
    if width > WIDEST_SWEEP_TICKS:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"was turned by {width} ticks, and has no stops within a turn of {TICKS_PER_TURN}: they are missing, or "
            "its horn slips; a joint without stops has turns_freely = true in robot.toml",
        )
    if recentre:
        middle = (lowest + highest) // 2
        offset, shift = _centred(servo, middle, offset)
        lowest, highest = lowest + shift, highest + shift
    if lowest < 0 or highest > MAX_TICK:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"its range of {lowest} to {highest} ticks crosses the seam between {MAX_TICK} and 0: its servo needs a "
            "new homing offset (--write-servos)",
        )
    return JointCalibration(servo, servo.servo_id, 0, offset, lowest, highest)


def place_free(servo: ServoSpec, middle: int, offset: int, *, recentre: bool) -> JointCalibration:
    """Place a joint that turns freely: its range is the turn, its middle the tick that lerobot takes for it [ticks]."""
    if recentre:
        offset = _centred(servo, middle, offset)[0]
    elif abs((middle := middle % TICKS_PER_TURN) - MIDDLE_TICK) > FREE_MIDDLE_WITHIN_TICKS:
        raise CalibrationError(
            "sweep",
            servo.joint,
            f"its middle is tick {middle}, and the file's format takes {MIDDLE_TICK} for it: the servo needs a new "
            "homing offset (--write-servos)",
        )
    return JointCalibration(servo, servo.servo_id, 0, offset, 0, MAX_TICK)


def _centred(servo: ServoSpec, middle: int, offset: int) -> tuple[int, int]:
    """Return the homing offset that makes a position the middle, within the register's range, and the shift with it."""
    encoder = middle + offset
    centred = (encoder - MIDDLE_TICK) % TICKS_PER_TURN
    if centred > TICKS_PER_TURN // 2:
        centred -= TICKS_PER_TURN
    centred = min(centred, servo.max_homing_offset)
    return centred, (encoder - centred) % TICKS_PER_TURN - middle


# A hand moves a joint further than this (9 deg) without noticing; less may be a twitch, or the arm that sinks.
LEAST_MOTION_TICKS = 100

ALONG_AXIS = 0.35  # a link whose end is seen within this slope (20 deg) of its axis is turned rather than moved
AT_JOINT_M = 0.005  # an end that is nearer to the joint's origin gives no direction [m]

# Cosine of the angle (18 deg) within which an axis counts as vertical: such a joint turns the arm in any pose.
VERTICAL = 0.95

# The arm points somewhere when its tip is so far from its foot; otherwise forward is the root link's x axis [m].
REACH_M = 0.05


@dataclass(frozen=True)
class AskedMotion:
    """Motion of one joint to ask for."""

    request: str  # imperative sentence without a full stop
    rises: bool  # True if the joint's position rises meanwhile


def asked_motions(robot: RobotModel) -> dict[str, AskedMotion]:
    """Return the motion to ask for each joint that turns, by joint."""
    words = _Words(robot)
    gripper = {} if robot.gripper is None else dict.fromkeys(robot.gripper.joints, robot.gripper)
    motions = {}
    for joint in robot.movable_joints:
        if (found := gripper.get(joint.name)) is not None:
            motions[joint.name] = AskedMotion("open the gripper", rises=found.open > found.closed)
        else:
            motions[joint.name] = words.motion(joint.name)
    return motions


def turned_the_other_way(servo: ServoSpec, motion: AskedMotion, moved_ticks: int) -> bool:
    """Return True when a servo turned against its sign; raise CalibrationError when it was hardly moved."""
    if abs(moved_ticks) < LEAST_MOTION_TICKS:
        raise CalibrationError(
            "direction",
            servo.joint,
            f"was moved by {abs(moved_ticks)} ticks only, {LEAST_MOTION_TICKS} are needed: {motion.request}, further",
        )
    expected = servo.sign if motion.rises else -servo.sign
    return (moved_ticks > 0) != (expected > 0)


def spoken(name: str) -> str:
    """Return the name of a link or joint as words."""
    return name.removesuffix("_link").replace("_", " ").replace("-", " ").strip() or name


class _Words:
    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        forward = ForwardPlacements(robot)
        self._zero: Mapping[str, float] = {
            joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.movable_joints
        }
        self._placed = forward.transforms(self._zero)
        self._axis = forward.axis
        self._tip = robot.tip_link or robot.links[-1]
        tip = self._placed[self._tip][:3, 3]
        reach = np.array([tip[0], tip[1], 0.0])
        away_m = float(np.linalg.norm(reach))
        self._forward = reach / away_m if away_m > REACH_M else np.array([1.0, 0.0, 0.0])

    def motion(self, name: str) -> AskedMotion:
        joint = self._robot.joints[name]
        place = self._placed[joint.child]
        axis, at_m = place[:3, :3] @ self._axis(joint.child), place[:3, 3]
        if joint.type == "prismatic":
            return self._shift(name, joint.child, axis)
        if abs(axis[2]) > VERTICAL:
            request = f"turn {spoken(name)} to the left, counter-clockwise as seen from above"
            return AskedMotion(request, rises=bool(axis[2] > 0.0))
        arm_m = self._end(joint.child) - at_m
        across_m = arm_m - axis * (axis @ arm_m)
        length_m = float(np.linalg.norm(arm_m))
        if np.linalg.norm(across_m) <= max(ALONG_AXIS * length_m, AT_JOINT_M):
            along = float(axis @ (arm_m if length_m > AT_JOINT_M else self._forward))
            # A right-handed turn about an axis that points away from the eye is clockwise.
            request = f"turn {spoken(name)} clockwise, as seen along the arm from its foot"
            return AskedMotion(request, rises=along >= 0.0)
        velocity: Vector = np.cross(axis, across_m).astype(np.float64)
        return self._shift(name, joint.child, velocity)

    def _shift(self, name: str, link: str, velocity: Vector) -> AskedMotion:
        left = np.cross((0.0, 0.0, 1.0), self._forward)
        parts = {"up": velocity[2], "forward": velocity @ self._forward, "to the left": velocity @ left}
        word = max(parts, key=lambda each: abs(parts[each]))
        way = {"up": "up", "forward": "forward, away from the arm's foot", "to the left": "to the left"}[word]
        request = f"move {spoken(name)} so that the far end of {spoken(link)} goes {way}"
        return AskedMotion(request, rises=bool(parts[word] > 0.0))

    def _end(self, link: str) -> Vector:
        """Return the end of a link: the next joint on the way to the tip, or the tip, shape (3,) [m]."""
        by_child = {joint.child: joint for joint in self._robot.joints.values()}
        end, at = self._tip, self._tip
        while at != link and (joint := by_child.get(at)) is not None:
            if joint.movable:
                end = at
            at = joint.parent
        ended: Vector = self._placed[end if at == link else link][:3, 3]
        return ended


# Names of steps; for directions and middles, the joint's name follows.
HOLD, SWEEP, WRITE = "hold", "sweep", "write"
DIRECTION, MIDDLE = "direction of ", "middle of "

# Answers.
RELAX, DONE, SKIP, SKIP_ALL, AS_IT_IS, WRITE_NOW, AGAIN = (
    "relax the arm",
    "done",
    "skip",
    "skip all",
    "go on with these ranges",
    "write",
    "sweep again",
)

# Share of the whole that each step begins at.
_SWEPT, _WRITING = 0.6, 0.95


class Act(Enum):
    """Act that an answer asks for."""

    RELAX = "relax"
    WRITE = "write"


@dataclass(frozen=True)
class Step:
    """Step of a procedure."""

    name: str  # unique in the procedure
    instruction: str  # what the person is to do, in sentences
    answers: tuple[str, ...]


@dataclass(frozen=True)
class SweptRange:
    """Range of one joint so far; positions count on across the seam between ticks 4095 and 0."""

    joint: str
    lowest: int  # lowest position [ticks]
    present: int  # latest position [ticks]
    highest: int  # highest position [ticks]
    expected_width: int  # width of its range in the URDF [ticks]
    done: bool
    note: str  # the missing part; empty for none


class CalibrationSession:
    """Calibration of one arm, from holding it to writing; with ``recentre`` its servos get new homing offsets."""

    def __init__(self, servos: Sequence[ServoSpec], motions: Mapping[str, AskedMotion], *, recentre: bool) -> None:
        self.servos = tuple(servos)
        self._motions = motions
        self.recentre = recentre
        self._sweep: Sweep | None = None
        self._offsets: Mapping[int, int] = {}
        self._asked_from: dict[int, int] = {}
        self._middles: dict[int, int] = {}
        self._drive_modes: dict[int, int] = {}  # 1 for servos that turn the other way than the format takes them to
        self._to_ask: list[ServoSpec] = []
        self._to_show: list[ServoSpec] = []
        self.findings: list[str] = []  # a sentence each
        self.to_mend: list[str] = []  # joints that turn the other way than the model; nothing is written meanwhile
        self.calibration: Calibration | None = None  # the result; None before the step that asks for it to be written
        # The step to answer; None once the session has ended.
        self.step: Step | None = Step(
            HOLD, "Torque will be switched off, and the arm sinks: hold it, then answer.", (RELAX,)
        )

    @property
    def progress(self) -> float:
        """Share of the steps that is done, 0 to 1."""
        if self.step is None:
            return 1.0
        if self._sweep is None:
            return 0.0
        if self.step.name == SWEEP:
            return _SWEPT * sum(each.done for each in self.ranges()) / len(self.servos)
        if self.step.name == WRITE:
            return _WRITING
        left = len(self._to_show) + len(self._to_ask)
        return _WRITING - (_WRITING - _SWEPT) * left / (2 * len(self.servos))

    def ranges(self) -> tuple[SweptRange, ...]:
        """Return the range of each joint; none before the sweep."""
        sweep = self._sweep
        return () if sweep is None else tuple(self._range(servo, sweep) for servo in self.servos)

    def _range(self, servo: ServoSpec, sweep: Sweep) -> SweptRange:
        servo_id, width = servo.servo_id, expected_width(servo)
        met = met_both_stops(servo, sweep.width(servo_id))
        share = min(sweep.width(servo_id) / width, 1.0)
        certain = share >= CERTAIN_SHARE or all(end.visits > 1 for end in sweep.ends[servo_id])
        done = certain if met else servo.turns_freely
        note = "" if done else f"{share:.0%} of the expected range"
        if met and not certain:
            note += ": move it to both stops once more"
        elif servo.turns_freely and not met:
            note = f"{'may turn' if share < 1.0 else 'turns'} freely: its middle is asked for"
        return SweptRange(
            servo.joint, sweep.lowest[servo_id], sweep.present[servo_id], sweep.highest[servo_id], width, done, note
        )

    def begin(self, ticks: Mapping[int, int], offsets: Mapping[int, int]) -> None:
        """Begin the sweep of the relaxed arm: positions, and registers HOMING_OFFSET, by servo id [ticks]."""
        self._sweep, self._offsets = Sweep(ticks), dict(offsets)
        self._ask_for_sweep()

    def _ask_for_sweep(self, *answers: str) -> None:
        self.findings, self.calibration = [], None
        self.to_mend = []
        self._middles, self._drive_modes = {}, {}
        free = ", ".join(spoken(servo.joint) for servo in self.servos if servo.turns_freely)
        also = f" {free.capitalize()} may have no stops: turn it as far as it goes, a turn at most." if free else ""
        self.step = Step(
            SWEEP,
            f"Move every joint by hand, slowly, from one stop to the other, in any order, the gripper too.{also}",
            (DONE, *answers),
        )

    def take(self, ticks: Mapping[int, int]) -> None:
        if self._sweep is not None and self.calibration is None:
            self._sweep.add(ticks)

    def answer(self, answer: str) -> Act | None:
        """Take the answer to the present step; return the act that is due. After CalibrationError the step stays."""
        step = self.step
        if step is None or answer not in step.answers:
            allowed = "none" if step is None else ", ".join(step.answers)
            raise CalibrationError("answer", answer, f"cannot be given now; what can be answered: {allowed}")
        if step.name == HOLD:
            return Act.RELAX
        if step.name == SWEEP:
            self._end_sweep(as_it_is=answer == AS_IT_IS)
        elif step.name.startswith(MIDDLE):
            servo = self._to_show.pop(0)
            self._middles[servo.servo_id] = self._swept.present[servo.servo_id]
            self._next()
        elif step.name.startswith(DIRECTION):
            self._take_direction(answer)
        elif answer == AGAIN:
            self._sweep = Sweep(self._swept.present)
            self._ask_for_sweep()
        else:
            return Act.WRITE
        return None

    def finish(self) -> None:
        """End the session: the calibration is written."""
        self.step = None

    @property
    def _swept(self) -> Sweep:
        if self._sweep is None:
            raise CalibrationError("answer", "", "nothing was swept yet")
        return self._sweep

    def _end_sweep(self, *, as_it_is: bool) -> None:
        short = [each for each in self.ranges() if not each.done]
        if short and not as_it_is:
            self._ask_for_sweep(AS_IT_IS)
            listed = ", ".join(f"{each.joint} has {each.note}" for each in short)
            raise CalibrationError(
                "sweep",
                short[0].joint,
                f"did not meet both stops ({listed}): move on, or answer {AS_IT_IS!r} where something is in the way",
            )
        # Refuses what no motion for directions could mend. Where the servo keeps its offset, the middle of a free joint
        # is checked when it is shown.
        present = self._swept.present
        self._calibrate(present if self.recentre else dict.fromkeys(present, MIDDLE_TICK))
        for each in short:
            self.findings.append(
                f"{each.joint} covered {each.note} only: its zero is wrong by half of the missing part"
            )
        self._to_show = [servo for servo in self.servos if needs_middle(servo, self._swept)]
        self._to_ask = [servo for servo in self.servos if servo.joint in self._motions]
        self._next()

    def _calibrate(self, middles: Mapping[int, int]) -> Calibration:
        """Compute the calibration; middles are positions of free joints, by servo id [ticks], in the sweep's count."""
        joints = []
        for servo in self.servos:
            servo_id = servo.servo_id
            offset = self._offsets[servo_id]
            if not needs_middle(servo, self._swept):
                placed = place(servo, self._swept, offset, recentre=self.recentre)
            else:
                placed = place_free(servo, middles[servo_id], offset, recentre=self.recentre)
            joints.append(replace(placed, drive_mode=self._drive_modes.get(servo_id, 0)))
        return Calibration(tuple(joints))

    def _take_direction(self, answer: str) -> None:
        servo = self._to_ask[0]
        motion = self._motions[servo.joint]
        if answer == DONE:
            moved = self._swept.present[servo.servo_id] - self._asked_from[servo.servo_id]
            try:
                mirrored = turned_the_other_way(servo, motion, moved)
            except CalibrationError:
                self._ask_direction(servo)
                raise
            self._note_direction(servo, mirrored=mirrored)
        skipped = self._to_ask if answer == SKIP_ALL else [servo] if answer == SKIP else []
        self.findings += [f"the direction of {each.joint} was not checked" for each in skipped]
        self._to_ask = [] if answer == SKIP_ALL else self._to_ask[1:]
        self._next()

    def _note_direction(self, servo: ServoSpec, *, mirrored: bool) -> None:
        if servo.zero == "ends":
            self._drive_modes[servo.servo_id] = int(mirrored)
            if mirrored:
                self.findings.append(f"{servo.joint} is mirrored: the calibration says so by drive_mode 1")
        elif mirrored:
            self.findings.append(
                f"{servo.joint} turned the other way than the model: its horn is mounted mirrored, or its servo counts "
                f"the other way; mount it as the model has it, or set sign = {-servo.sign} for it in the arm's "
                "robot.toml, and calibrate again, before anything moves"
            )
            self.to_mend.append(servo.joint)

    def _next(self) -> None:
        """Go on with the middles, the directions, and the question whether to write."""
        if self._to_show:
            name = self._to_show[0].joint
            self.step = Step(
                f"{MIDDLE}{name}",
                f"Turn {spoken(name)} to the middle of its way, as the model has it at zero, and hold it there.",
                (DONE,),
            )
        elif self._to_ask:
            self._ask_direction(self._to_ask[0])
        else:
            self.calibration = self._calibrate(self._middles)
            question = "Write the calibration to its file? The servos stay as they are."
            if self.recentre:
                question = "Write the calibration to the servos and to its file?"
            if self.to_mend:
                question = f"Nothing is written: mend {', '.join(self.to_mend)} first, or sweep again."
            self.step = Step(WRITE, question, (AGAIN,) if self.to_mend else (WRITE_NOW, AGAIN))

    def _ask_direction(self, servo: ServoSpec) -> None:
        self._asked_from[servo.servo_id] = self._swept.present[servo.servo_id]
        request = self._motions[servo.joint].request
        self.step = Step(
            f"{DIRECTION}{servo.joint}",
            f"Hold the arm about as the model has it at zero. Now {request}, then answer.",
            (DONE, SKIP, SKIP_ALL),
        )
