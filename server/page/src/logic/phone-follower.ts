import { Vector3, type Quaternion } from "three";
import { headingOf, motionBetween, tiltBetween, type PhonePose } from "./phone-pose";

/** Velocities of the tip as shares of the greatest, -1 to 1. */
export type TipShares = Record<"x" | "y" | "z" | "roll" | "pitch" | "yaw", number>;

/** What the phone's motion does: move and turn the tip as the phone, turn it only, or steer its velocity by tilting. */
export type PhoneMode = "move" | "turn" | "tilt";

export interface TipLimits {
  linear_m_s: number;
  angular_rad_s: number;
}

/** Time from the beginning of a grip to full effect, so that nothing jumps [s]. */
export const RAMP_S = 0.4;

/** A phone that has not told its pose for so long is lost: the arm stops [s]. */
export const DROPOUT_S = 0.08;

/** Time constant with which the tip makes up for what it is behind [s]. */
const FOLLOWING_S = 0.1;

/** Most that the tip may be behind, as time at full speed: so long it goes on when the phone has stopped [s]. */
const MAX_BEHIND_S = 0.2;

/** Tilt that has no effect, as no hand is steady, and tilt for full speed [rad]. */
const DEAD_TILT_RAD = 0.07;
const FULL_TILT_RAD = 0.5;

interface Grip {
  began_ms: number;
  first: PhonePose;
  heading: Quaternion;
  last: PhonePose;
  last_ms: number;
  /** Time until which the tip has made up for what it was behind [ms]. */
  followed_ms: number;
  linear_m: Vector3;
  angular_rad: Vector3;
}

/** Follower of a phone's motion: between clutch and release it returns the velocities for the tip. */
export class PhoneFollower {
  mode: PhoneMode = "move";
  /** Way of the tip for the way of the phone; of a tilt, share of the full speed. */
  scale = 1;
  private pose: { pose: PhonePose; at_ms: number } | null = null;
  private held: Grip | null = null;

  constructor(private readonly limits: () => TipLimits) {}

  /** True between clutch and release. */
  get gripping(): boolean {
    return this.held !== null;
  }

  /** Return true while the phone tells its pose. */
  isTracked(now_ms: number): boolean {
    return this.pose !== null && now_ms - this.pose.at_ms <= DROPOUT_S * 1000;
  }

  /** Take a new pose of the phone; null for a moment in which it does not know its pose. */
  update(pose: PhonePose | null, now_ms: number): void {
    if (pose === null) return;
    this.pose = { pose, at_ms: now_ms };
    const grip = this.held;
    if (grip === null) return;
    if (now_ms - grip.last_ms > DROPOUT_S * 1000) return this.begin(pose, now_ms);
    const { linear_m, angular_rad } = motionBetween(grip.last, pose, grip.heading);
    grip.linear_m.addScaledVector(linear_m, this.scale);
    grip.angular_rad.addScaledVector(angular_rad, this.scale);
    const { linear_m_s, angular_rad_s } = this.limits();
    // What is not made up for in time is given up: the arm does not go on for long after the phone has stopped.
    grip.linear_m.clampLength(0, linear_m_s * MAX_BEHIND_S);
    grip.angular_rad.clampLength(0, angular_rad_s * MAX_BEHIND_S);
    grip.last = pose;
    grip.last_ms = now_ms;
  }

  /** Close the clutch; return false while the phone does not tell its pose. */
  grip(now_ms: number): boolean {
    if (this.pose === null || !this.isTracked(now_ms)) return false;
    this.begin(this.pose.pose, now_ms);
    return true;
  }

  release(): void {
    this.held = null;
  }

  /** Return the velocities from now on: all zero without a grip, and while the phone does not tell its pose. */
  velocity(now_ms: number): TipShares {
    const grip = this.held;
    if (grip === null || !this.isTracked(now_ms)) return { ...STILL };
    const ramp = Math.min(1, (now_ms - grip.began_ms) / (RAMP_S * 1000));
    if (this.mode === "tilt") return this.tiltVelocity(grip, ramp);
    const elapsed_s = (now_ms - grip.followed_ms) / 1000;
    grip.followed_ms = now_ms;
    const { linear_m_s, angular_rad_s } = this.limits();
    const linear = followed(grip.linear_m, linear_m_s, ramp, elapsed_s);
    const angular = followed(grip.angular_rad, angular_rad_s, ramp, elapsed_s);
    const [x, y, z] = this.mode === "move" ? linear.toArray() : [0, 0, 0];
    const [roll, pitch, yaw] = angular.toArray();
    return { x, y, z, roll, pitch, yaw };
  }

  private begin(pose: PhonePose, now_ms: number): void {
    const heading = headingOf(pose);
    const still = { linear_m: new Vector3(), angular_rad: new Vector3() };
    this.held = { began_ms: now_ms, first: pose, heading, last: pose, last_ms: now_ms, followed_ms: now_ms, ...still };
  }

  private tiltVelocity({ first, last }: Grip, ramp: number): TipShares {
    const { forward_rad, left_rad } = tiltBetween(first, last);
    const share = (tilt_rad: number): number => {
      const beyond = Math.max(0, Math.abs(tilt_rad) - DEAD_TILT_RAD) / (FULL_TILT_RAD - DEAD_TILT_RAD);
      return Math.sign(tilt_rad) * Math.min(1, beyond) * this.scale * ramp;
    };
    return { ...STILL, x: limited(share(forward_rad)), y: limited(share(left_rad)) };
  }
}

const STILL: TipShares = { x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0 };

function limited(share: number): number {
  return Math.max(-1, Math.min(1, share));
}

/** Return the velocity that makes up for a way, as shares of the greatest; the way shrinks by what was made in the period before. */
function followed(behind: Vector3, greatest: number, ramp: number, elapsed_s: number): Vector3 {
  const velocity = behind.clone().divideScalar(FOLLOWING_S).clampLength(0, greatest).multiplyScalar(ramp);
  behind.addScaledVector(velocity, -Math.min(elapsed_s, FOLLOWING_S));
  return velocity.divideScalar(greatest);
}
