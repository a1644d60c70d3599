import { Quaternion, Vector3 } from "three";
import { beforeEach, describe, expect, it, test } from "vitest";
import { DROPOUT_S, PhoneFollower, RAMP_S, type TipShares } from "./phone-follower";
import { poseOfDevice, type PhonePose } from "./phone-pose";

const PERIOD_MS = 20;
const LIMITS = { linear_m_s: 0.2, angular_rad_s: 0.8 };

/** An upright phone that looks along x. */
const UPRIGHT = new Quaternion().setFromAxisAngle(new Vector3(0, 0, 1), -Math.PI / 2).multiply(new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), Math.PI / 2));

function at(x: number, y = 0, z = 0, orientation = UPRIGHT): PhonePose {
  return { position_m: new Vector3(x, y, z), orientation };
}

let follower: PhoneFollower;
let now_ms = 0;

beforeEach(() => {
  follower = new PhoneFollower(() => LIMITS);
  now_ms = 1000;
});

/** Give so many poses, one a period, and return the velocities and the way that they make [m or rad]. */
function play(poses: (PhonePose | null)[]): { shares: TipShares[]; way: TipShares } {
  const way: TipShares = { x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0 };
  const shares = poses.map((pose) => {
    now_ms += PERIOD_MS;
    follower.update(pose, now_ms);
    const velocity = follower.velocity(now_ms);
    for (const axis of ["x", "y", "z"] as const) way[axis] += (velocity[axis] * LIMITS.linear_m_s * PERIOD_MS) / 1000;
    for (const axis of ["roll", "pitch", "yaw"] as const) way[axis] += (velocity[axis] * LIMITS.angular_rad_s * PERIOD_MS) / 1000;
    return velocity;
  });
  return { shares, way };
}

function grip(pose = at(0)): void {
  follower.update(pose, now_ms);
  expect(follower.grip(now_ms)).toBe(true);
}

/** Poses on a straight way from the start, at a speed [m/s]. */
function along(direction: [number, number, number], speed_m_s: number, count: number): PhonePose[] {
  return Array.from({ length: count }, (_, index) => {
    const way_m = (speed_m_s * (index + 1) * PERIOD_MS) / 1000;
    return at(direction[0] * way_m, direction[1] * way_m, direction[2] * way_m);
  });
}

describe("the clutch", () => {
  it("moves nothing while it is open", () => {
    const { way } = play(along([1, 0, 0], 0.1, 50));
    expect(way).toEqual({ x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0 });
  });

  it("does not close without a pose", () => {
    expect(follower.grip(now_ms)).toBe(false);
    follower.update(at(0), now_ms);
    expect(follower.grip(now_ms + DROPOUT_S * 1000 + 1)).toBe(false);
  });

  it("stops at once when it is opened", () => {
    grip();
    expect(play(along([1, 0, 0], 0.1, 50)).shares.at(-1)?.x).toBeGreaterThan(0.4);
    follower.release();
    expect(follower.velocity(now_ms)).toEqual({ x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0 });
  });

  it("begins anew where the phone is then", () => {
    grip();
    follower.release();
    play(along([1, 0, 0], 5, 50));
    grip(at(5));
    expect(play([at(5), at(5), at(5)]).way.x).toBe(0);
  });
});

test.each([
  [1, 0.1],
  [0.25, 0.025],
])("with the scale %d a way of 0.1 m moves the tip by %d m", (scale, expected_m) => {
  follower.scale = scale;
  grip();
  const poses = along([1, 0, 0], 0.1, 50);
  const { way } = play([...poses, ...Array.from({ length: 50 }, () => at(0.1))]);
  expect(way.x).toBeCloseTo(expected_m, 2);
  expect(Math.abs(way.y) + Math.abs(way.z)).toBeLessThan(1e-9);
});

test("the effect grows from nothing in each grip", () => {
  for (let round = 0; round < 2; round += 1) {
    grip();
    const { shares } = play(along([1, 0, 0], 0.2, 60));
    const greatest_at = (s: number): number => Math.max(...shares.slice(0, (s * 1000) / PERIOD_MS).map(({ x }) => x));
    expect(greatest_at(PERIOD_MS / 1000)).toBeLessThan(0.05);
    expect(greatest_at(RAMP_S / 2)).toBeLessThanOrEqual(0.5);
    expect(greatest_at(1)).toBeGreaterThan(0.9);
    follower.release();
    now_ms += 1000;
  }
});

test("a phone that is faster than the limits moves the tip at the limit, and for 0.2 s longer at most", () => {
  grip();
  const { shares } = play(along([1, 1, 0], 3, 50));
  for (const { x, y, z } of shares) expect(Math.hypot(x, y, z)).toBeLessThanOrEqual(1 + 1e-9);
  const { way } = play(Array.from({ length: 100 }, () => at(3, 3)));
  expect(Math.hypot(way.x, way.y)).toBeLessThanOrEqual(LIMITS.linear_m_s * 0.2 + 1e-9);
});

describe("a dropout", () => {
  it("stops the arm", () => {
    grip();
    play(along([1, 0, 0], 0.1, 50));
    const { shares } = play(Array.from({ length: 10 }, () => null));
    expect(shares.at(-1)?.x).toBe(0);
    expect(shares.findIndex(({ x }) => x === 0) * PERIOD_MS).toBeLessThanOrEqual(100);
  });

  it("moves nothing of the way that it hid, and begins with a ramp", () => {
    grip();
    play(along([1, 0, 0], 0.1, 50));
    play(Array.from({ length: 10 }, () => null));
    const { shares, way } = play([at(1), at(1.01), at(1.02), at(1.03)]);
    expect(way.x).toBeLessThan(0.01);
    expect(Math.max(...shares.map(({ x }) => x))).toBeLessThan(0.2);
  });
});

test("the tip turns as the phone does", () => {
  grip();
  const poses = Array.from({ length: 100 }, (_, index) => {
    const yaw = new Quaternion().setFromAxisAngle(new Vector3(0, 0, 1), Math.min(0.3, index * 0.006));
    return at(0, 0, 0, yaw.multiply(UPRIGHT));
  });
  const { way } = play(poses);
  expect(way.yaw).toBeCloseTo(0.3, 1);
  expect(Math.abs(way.roll) + Math.abs(way.pitch)).toBeLessThan(1e-6);
});

test("turning only leaves the tip where it is", () => {
  follower.mode = "turn";
  grip();
  expect(play(along([1, 0, 0], 0.1, 50)).way.x).toBe(0);
});

describe("tilting", () => {
  const flat = (beta: number, gamma: number): PhonePose | null => poseOfDevice({ alpha: 30, beta, gamma }, 0);

  beforeEach(() => {
    follower.mode = "tilt";
    grip(flat(20, 0) ?? at(0));
    play(Array.from({ length: 30 }, () => flat(20, 0)));
  });

  it.each([
    ["the top away", -10, 0, "x", 1],
    ["the top towards the user", 50, 0, "x", -1],
    ["to the left", 20, -30, "y", 1],
    ["to the right", 20, 30, "y", -1],
  ] as const)("%s steers", (_, beta, gamma, axis, sign) => {
    const { shares } = play([flat(beta, gamma)]);
    expect(Math.sign(shares[0]?.[axis] ?? 0)).toBe(sign);
    expect(Math.abs(shares[0]?.[axis] ?? 0)).toBeGreaterThan(0.7);
  });

  it("has a dead zone", () => {
    const shares = play([flat(22, 2)]).shares[0];
    expect(Object.values(shares ?? { x: 1 }).every((share) => Math.abs(share) === 0)).toBe(true);
  });

  it("goes by the scale, and to the limit at most", () => {
    follower.scale = 0.1;
    expect(play([flat(-70, 0)]).shares[0]?.x).toBeCloseTo(0.1);
    follower.scale = 4;
    expect(play([flat(-70, 0)]).shares[0]?.x).toBe(1);
  });
});
