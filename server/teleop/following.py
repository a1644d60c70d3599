"""Following: when a follower moves, and how fast; pure logic, time is an argument."""

import math
from dataclasses import dataclass
from enum import StrEnum

# Samples come every 10 to 20 ms; a wireless network has pauses of a tenth of a second.
STALE_S = 0.2

# Someone who sees the follower stand for longer has let go of the leader.
RETURN_S = 2.0

# An error shrinks to a third in this time [s]. With less than 0.12 s and two ticks of delay a follower swings past its
# target by up to a third of the error.
TRACKING_TIME_S = 0.15

# With slow planners, at least this number of their latencies: with 0.15 s and a latency of 0.095 s a
# follower swings to 1.17 times the angle of its leader, with two latencies to 1.03 times.
TRACKING_LATENCIES = 2.0

# Share of the acceleration limit with which an error is closed: the arm process rounds the corners with the rest.
ACCELERATION_SHARE = 0.5


class FollowingPhase(StrEnum):
    """Phases of teleoperation."""

    IDLE = "idle"
    RAMPING = "ramping"
    FOLLOWING = "following"
    BRAKING = "braking"
    HOLDING = "holding"


class FollowerAct(StrEnum):
    """Act that a tick asks for."""

    NOTHING = "nothing"
    RAMP = "ramp"
    FOLLOW = "follow"
    BRAKE = "brake"


class Following:
    """State machine of one follower.

    It begins with a ramp, a planned motion to where the leader is, and so goes on after every hold.
    """

    def __init__(self) -> None:
        self.phase = FollowingPhase.RAMPING
        self.message = "the follower goes to where the leader is"
        self._asked = False
        self._stale_since_s = math.inf

    @property
    def ended(self) -> bool:
        """True when the follower follows no more, and will not again."""
        return self.phase is FollowingPhase.IDLE

    def tick(self, now_s: float, age_s: float, *, jump: str = "", obstacle: str = "") -> FollowerAct:
        """Decide on the present moment.

        Args:
            age_s: time since the leader's last sample [s].
            jump: jump of the leader in words; empty if there was none.
            obstacle: reason for which the follower cannot go on; empty if there is none.

        Returns:
            RAMP once for each ramp, BRAKE once for each end of a motion.
        """
        if self.ended:
            return FollowerAct.NOTHING
        if obstacle:
            return self.end(obstacle)
        stale = age_s > STALE_S
        match self.phase:
            case FollowingPhase.RAMPING:
                if not self._asked and not stale:
                    self._asked = True
                    return FollowerAct.RAMP
                if stale:
                    return self._wait_for_leader(now_s)
            case FollowingPhase.FOLLOWING:
                if jump:
                    return self._hold(f"{jump}: close the clutch to go on")
                return self._wait_for_leader(now_s) if stale else FollowerAct.FOLLOW
            case FollowingPhase.BRAKING:
                if not stale:
                    self._ramp()
                elif now_s - self._stale_since_s > RETURN_S:
                    return self.end(f"the leader has sent nothing for {RETURN_S:g} s")
        return FollowerAct.NOTHING

    def take_ramp_end(self, failure: str) -> None:
        """Take the end of the ramp, or the reason for which the ramp did not arrive."""
        if self.phase is not FollowingPhase.RAMPING:
            return
        if failure:
            self.end(f"the follower does not reach the leader: {failure}")
        else:
            self.phase, self.message = FollowingPhase.FOLLOWING, ""

    def set_clutch(self, *, closed: bool) -> FollowerAct:
        """Open the clutch, so that the follower holds, or close it, so that it goes to the leader and follows."""
        if self.ended:
            return FollowerAct.NOTHING
        if not closed:
            return self._hold("the clutch is open")
        if self.phase is FollowingPhase.HOLDING:
            self._ramp()
        return FollowerAct.NOTHING

    def interrupt(self, now_s: float, reason: str) -> FollowerAct:
        """Brake, and ramp again as soon as that can be: the follower came to rest by itself."""
        self.phase, self.message, self._stale_since_s = FollowingPhase.BRAKING, reason, now_s
        return FollowerAct.BRAKE

    def end(self, reason: str) -> FollowerAct:
        if self.ended:
            return FollowerAct.NOTHING
        self.phase, self.message = FollowingPhase.IDLE, reason
        return FollowerAct.BRAKE

    def _ramp(self) -> None:
        self.phase, self.message = FollowingPhase.RAMPING, "the follower goes to where the leader is"
        self._asked = False

    def _hold(self, message: str) -> FollowerAct:
        self.phase, self.message = FollowingPhase.HOLDING, message
        return FollowerAct.BRAKE

    def _wait_for_leader(self, now_s: float) -> FollowerAct:
        self.phase, self.message = FollowingPhase.BRAKING, f"the leader has sent nothing for {STALE_S:g} s"
        self._stale_since_s = now_s
        return FollowerAct.BRAKE


@dataclass(frozen=True)
class TrackingLimits:
    """Limits of a joint that follows."""

    velocity_rad_s: float
    acceleration_rad_s2: float


def tracking_velocity(error_rad: float, leader_rad_s: float, limits: TrackingLimits, latency_s: float) -> float:
    """Return the leader's velocity plus a part that closes the error [rad/s], within which the joint can brake."""
    tracking_time_s = max(TRACKING_TIME_S, TRACKING_LATENCIES * latency_s)
    braking = math.sqrt(2.0 * ACCELERATION_SHARE * limits.acceleration_rad_s2 * abs(error_rad))
    closing = math.copysign(min(abs(error_rad) / tracking_time_s, braking), error_rad)
    velocity = leader_rad_s + closing
    return min(max(velocity, -limits.velocity_rad_s), limits.velocity_rad_s)
