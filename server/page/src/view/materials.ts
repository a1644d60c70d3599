import { DoubleSide, MeshBasicMaterial, MeshLambertMaterial, type Material } from "three";
import type { Paint } from "./figure";
import type { Theme } from "./theme";

const GHOST_OPACITY = 0.45;

/** The materials of the view; they change their colours with the theme and are shared by all shapes. */
export class Materials {
  readonly arm = new MeshLambertMaterial();
  readonly arm_dark = new MeshLambertMaterial();
  readonly ghost = new MeshLambertMaterial({
    transparent: true,
    opacity: GHOST_OPACITY,
    depthWrite: false,
    // Links that did not move are in one place with the arm's own, which are then seen.
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 1,
  });
  readonly collision = new MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.7, depthTest: false });
  readonly path = new MeshBasicMaterial();
  readonly object = new MeshLambertMaterial({ transparent: true, opacity: 0.8, side: DoubleSide });
  private theme: Theme;
  private off_target = false;

  /** @param theme - the colours to begin with. */
  constructor(theme: Theme) {
    this.theme = theme;
    this.setTheme(theme);
  }

  /** Takes other colours. */
  setTheme(theme: Theme): void {
    this.theme = theme;
    this.arm.color.set(theme.arm);
    this.arm_dark.color.set(theme.arm_dark);
    this.collision.color.set(theme.collision);
    this.path.color.set(theme.path);
    this.object.color.set(theme.object);
    this.setOffTarget(this.off_target);
  }

  /** Shows by the ghost's colour whether it gets to the target. */
  setOffTarget(off_target: boolean): void {
    this.off_target = off_target;
    this.ghost.color.set(off_target ? this.theme.ghost_off : this.theme.ghost);
  }

  /** Paints shapes without a colour of their own as the arm. */
  readonly armPaint: Paint = (shape, link_index): Material | null => {
    if (shape?.querySelector("material") != null) return null;
    // Links that touch differ, so that one sees which joint turns.
    return link_index % 2 === 0 ? this.arm_dark : this.arm;
  };
}
