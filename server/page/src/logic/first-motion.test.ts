import { expect, test } from "vitest";
import { emptyState, type State } from "../state/state";
import { firstPose } from "./first-motion";

function state(position_rad: number, named: State["named"]): State {
  const joints = { names: ["a"], position_rad: [position_rad], velocity: [], effort: [], stamp: 0 };
  return { ...emptyState("ws://here"), joints, limits: { a: [-1, 1] }, named };
}

const NAMED: State["named"] = {
  here: { saved: false, joints: { a: 0.05 } },
  far: { saved: false, joints: { a: 0.9 } },
  near: { saved: false, joints: { a: -0.4 } },
  own: { saved: true, joints: { a: 0.3 } },
  beyond: { saved: false, joints: { a: 1.2 } },
};

test("the first motion is the shortest that one sees, to a described pose within the limits", () => {
  expect(firstPose(state(0, NAMED))).toBe("near");
  expect(firstPose(state(-0.4, NAMED))).toBe("here");
});

test("without such a pose, or without positions, there is none", () => {
  expect(firstPose(state(0, { here: { saved: false, joints: { a: 0.1 } } }))).toBeNull();
  expect(firstPose({ ...state(0, NAMED), joints: emptyState("").joints })).toBeNull();
});
