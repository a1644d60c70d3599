import type { Object3D } from "three";
import { isOpen } from "../logic/layout";
import { poseKey } from "../logic/sequence";
import type { State } from "../state/state";
import type { PageStore } from "../state/store";
import type { Robot } from "./robot";
import type { SceneComponent, Viewer } from "./viewer";

const WIDTH_PX = 112;
const HEIGHT_PX = 84;

/** Pictures of the arm at the waypoints of the sequence and in the poses of a class, drawn one a frame while their panel is open. */
export class Thumbnails implements SceneComponent {
  constructor(
    private readonly viewer: Viewer,
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly background: Object3D,
  ) {}

  update({ layout, sequence: { waypoints }, classroom, thumbnails }: State): void {
    const { arm } = this.robot;
    const poses = [
      ...(isOpen(layout, "sequence") ? waypoints.map(({ joints_rad }) => joints_rad) : []),
      ...(isOpen(layout, "class") ? classroom.map(({ seen_rad }) => seen_rad) : []),
    ];
    const missing = poses.find((pose) => !(poseKey(pose) in thumbnails));
    if (arm === null || missing === undefined) return;
    const before = arm.jointValues();
    arm.setJoints(missing);
    const picture = this.viewer.portrait(arm.robot, this.background, WIDTH_PX, HEIGHT_PX);
    arm.setJoints(before);
    const keys = poses.map(poseKey);
    const kept = Object.entries(thumbnails).filter(([key]) => keys.includes(key));
    this.store.set({ thumbnails: { ...Object.fromEntries(kept), [poseKey(missing)]: picture } });
    // The next one.
    this.viewer.request();
  }

  /** Draw all again: the arm looks otherwise. */
  reset(): void {
    this.store.set({ thumbnails: {} });
  }
}
