import {
  AmbientLight,
  AxesHelper,
  Color,
  DirectionalLight,
  DoubleSide,
  GridHelper,
  Group,
  MeshBasicMaterial,
  MeshLambertMaterial,
  type Material,
  type Scene,
} from "three";
import type { MaterialSelector } from "./robot-model";

/** Colours of the view. */
export interface Theme {
  background: number;
  grid: number;
  grid_axis: number;
  arm: number;
  arm_dark: number;
  ghost: number;
  ghost_off: number;
  path: number;
  object: number;
  collision: number;
  missing: number;
}

const LIGHT: Theme = {
  background: 0xeef1f4,
  grid: 0xc9d0d7,
  grid_axis: 0x94a0ac,
  arm: 0xf0b323,
  arm_dark: 0x3a434d,
  ghost: 0x2f7fe0,
  ghost_off: 0xd92c2c,
  path: 0x1f5fb0,
  object: 0x6f9a5c,
  collision: 0xb03fc0,
  missing: 0xd96a2c,
};

const DARK: Theme = {
  ...LIGHT,
  background: 0x161b21,
  grid: 0x2b333c,
  grid_axis: 0x4c5864,
  arm_dark: 0x59646f,
  ghost: 0x56a0ff,
  ghost_off: 0xff5a52,
  path: 0x7db7ff,
  collision: 0xe07cf0,
};

/** Return the present theme: the user's choice, else that of the system. */
export function currentTheme(): Theme {
  const chosen = document.documentElement.dataset["theme"];
  if (chosen === "light") return LIGHT;
  if (chosen === "dark") return DARK;
  return matchMedia("(prefers-color-scheme: dark)").matches ? DARK : LIGHT;
}

/** Call back whenever the theme may have changed. */
export function watchTheme(changed: () => void): void {
  const system = matchMedia("(prefers-color-scheme: dark)");
  system.addEventListener("change", changed);
  const attributes = { attributes: true, attributeFilter: ["data-theme"] };
  new MutationObserver(changed).observe(document.documentElement, attributes);
}

const GHOST_OPACITY = 0.45;

/** Materials of the view, which follow the theme and are shared by all shapes. */
export class Materials {
  readonly arm = new MeshLambertMaterial();
  readonly arm_dark = new MeshLambertMaterial();
  readonly ghost = new MeshLambertMaterial({
    transparent: true,
    opacity: GHOST_OPACITY,
    depthWrite: false,
    // Links of the ghost that have not moved coincide with the arm's, which are drawn before them.
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 1,
  });
  readonly collision = new MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.7, depthTest: false });
  readonly path = new MeshBasicMaterial();
  readonly object = new MeshLambertMaterial({ transparent: true, opacity: 0.8, side: DoubleSide });
  private theme: Theme;
  private off_target = false;

  /** @param theme - initial colours. */
  constructor(theme: Theme) {
    this.theme = theme;
    this.setTheme(theme);
  }

  /** Apply other colours. */
  setTheme(theme: Theme): void {
    this.theme = theme;
    this.arm.color.set(theme.arm);
    this.arm_dark.color.set(theme.arm_dark);
    this.collision.color.set(theme.collision);
    this.path.color.set(theme.path);
    this.object.color.set(theme.object);
    this.setOffTarget(this.off_target);
  }

  /** Set the ghost's colour: a warning where it does not reach the target. */
  setOffTarget(off_target: boolean): void {
    this.off_target = off_target;
    this.ghost.color.set(off_target ? this.theme.ghost_off : this.theme.ghost);
  }

  /** Return the arm's material for shapes without a colour of their own. */
  readonly armMaterial: MaterialSelector = (shape, link_index): Material | null => {
    if (shape?.querySelector("material") != null) return null;
    // Adjacent links differ, so that the moving joint is visible.
    return link_index % 2 === 0 ? this.arm_dark : this.arm;
  };
}

const GRID_SIZE_M = 1;
// One line every 5 cm, so that lengths can be read.
const GRID_LINES = 20;
const AXES_LENGTH_M = 0.06;

/** Table grid, lights and background. */
export class Environment {
  private readonly group = new Group();
  private grid: GridHelper | null = null;

  /** @param scene - scene to add them to. */
  constructor(private readonly scene: Scene) {
    const sun = new DirectionalLight(0xffffff, 2.2);
    sun.position.set(0.6, -0.8, 1.4);
    const fill = new DirectionalLight(0xffffff, 0.7);
    fill.position.set(-1, 0.8, 0.4);
    const axes = new AxesHelper(AXES_LENGTH_M);
    // Above the grid, so that the two do not flicker.
    axes.position.z = 0.001;
    this.group.add(sun, fill, new AmbientLight(0xffffff, 1.1), axes);
    scene.add(this.group);
  }

  /** Apply other colours. */
  setTheme(theme: Theme): void {
    this.scene.background = new Color(theme.background);
    this.grid?.removeFromParent();
    this.grid?.dispose();
    this.grid = new GridHelper(GRID_SIZE_M, GRID_LINES, theme.grid_axis, theme.grid);
    // three's grid lies in x and z, as its y axis is up.
    this.grid.rotation.x = Math.PI / 2;
    this.group.add(this.grid);
  }
}
