import * as THREE from "three";
import type { UnitSystem } from "../logic/numbers";
import { backgroundMaterial, srgb } from "./flat-material";
import { Ground } from "./ground";
import type { MaterialSelector } from "./robot-model";
import { SoftShadow } from "./soft-shadow";

const LIGHT = {
  // At the picture's upper edge, and at its lower one.
  sky: 0xd3dce5,
  background: 0xf3f5f7,
  ground: 0xffffff,
  grid: 0xd9dfe5,
  grid_axis: 0xb4bec8,
  grid_label: 0x5c6874,
  // Darkness of the arm's shadow, from 0 to 1.
  shadow: 0.34,
  arm: 0xf0b323,
  arm_dark: 0x3a434d,
  ghost: 0x2f7fe0,
  ghost_off: 0xd92c2c,
  path: 0x1f5fb0,
  object: 0x6f9a5c,
  collision: 0xb03fc0,
  missing: 0xd96a2c,
  swept: 0x35a0a0,
};

/** Colours of the view. */
export type Theme = typeof LIGHT;

const DARK: Theme = {
  ...LIGHT,
  sky: 0x262f3a,
  background: 0x12161b,
  ground: 0x222a33,
  grid: 0x303a45,
  grid_axis: 0x46525f,
  grid_label: 0x9aa7b4,
  shadow: 0.6,
  arm_dark: 0x59646f,
  ghost: 0x56a0ff,
  ghost_off: 0xff5a52,
  path: 0x7db7ff,
  collision: 0xe07cf0,
};

export function currentTheme(): Theme {
  const chosen = document.documentElement.dataset.theme;
  if (chosen === "light") return LIGHT;
  if (chosen === "dark") return DARK;
  return matchMedia("(prefers-color-scheme: dark)").matches ? DARK : LIGHT;
}

export function watchTheme(changed: () => void): void {
  const system = matchMedia("(prefers-color-scheme: dark)");
  system.addEventListener("change", changed);
  const attributes = { attributes: true, attributeFilter: ["data-theme"] };
  new MutationObserver(changed).observe(document.documentElement, attributes);
}

const GHOST_OPACITY = 0.45;

/** Materials of the view, which follow the theme and are shared by all shapes. */
export class Materials {
  // The shine of matt plastic; it is computed for the arm's pixels alone.
  readonly arm = new THREE.MeshPhongMaterial({ shininess: 24, specular: 0x222222 });
  readonly arm_dark = new THREE.MeshPhongMaterial({ shininess: 24, specular: 0x222222 });
  readonly ghost = new THREE.MeshLambertMaterial({
    transparent: true,
    opacity: GHOST_OPACITY,
    depthWrite: false,
    // Links of the ghost that have not moved coincide with the arm's, which are drawn before them.
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 1,
  });
  readonly collision = new THREE.MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.7, depthTest: false });
  readonly path = new THREE.MeshBasicMaterial();
  // Seen through the arm, which stands in the middle of it.
  readonly swept = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.4, side: THREE.DoubleSide, depthTest: false });
  readonly swept_now = new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, depthTest: false, transparent: true });
  readonly object = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.8, side: THREE.DoubleSide });
  private theme: Theme;
  private off_target = false;

  constructor(theme: Theme) {
    this.theme = theme;
    this.setTheme(theme);
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    for (const name of ["arm", "arm_dark", "collision", "path", "swept", "object"] as const) this[name].color.set(theme[name]);
    this.swept_now.color.set(theme.swept);
    this.setOffTarget(this.off_target);
  }

  setOffTarget(off_target: boolean): void {
    this.off_target = off_target;
    this.ghost.color.set(off_target ? this.theme.ghost_off : this.theme.ghost);
  }

  /** Return the arm's material for shapes without a colour of their own. */
  readonly armMaterial: MaterialSelector = (shape, link_index): THREE.Material | null => {
    if (shape?.querySelector("material") != null) return null;
    // Adjacent links differ, so that the moving joint is visible.
    return link_index % 2 === 0 ? this.arm_dark : this.arm;
  };
}

// Bands of the background's gradient, each of which is even.
const SKY_BANDS = 16;
const LIGHT_DIRECTION = new THREE.Vector3(0.35, -0.55, 1.3);

/** Ground, lights, shadow and background. */
export class Environment {
  private readonly ground = new Ground();
  private readonly shadow: SoftShadow;
  private readonly hemisphere = new THREE.HemisphereLight();
  readonly sky = new THREE.Mesh(new THREE.PlaneGeometry(2, 2, 1, SKY_BANDS), backgroundMaterial());

  constructor(scene: THREE.Scene) {
    const sun = new THREE.DirectionalLight(0xfff6ea, 1.75);
    sun.position.copy(LIGHT_DIRECTION);
    // From behind, so that dark parts stand out from a dark background.
    const rim = new THREE.DirectionalLight(0xdbe8ff, 0.8);
    rim.position.set(-0.9, 0.9, 0.5);
    this.hemisphere.position.set(0, 0, 1);
    this.shadow = new SoftShadow(scene, LIGHT_DIRECTION);
    this.sky.frustumCulled = false;
    this.sky.renderOrder = -10;
    scene.add(this.sky, sun, rim, this.hemisphere, this.ground.group);
  }

  /** Apply other colours, and other units of the ground's lengths. */
  setTheme(theme: Theme, units: UnitSystem): void {
    colorSky(this.sky.geometry, theme);
    this.hemisphere.color.set(0xffffff);
    this.hemisphere.groundColor.set(theme.grid_axis);
    this.hemisphere.intensity = 1.15;
    this.ground.setTheme(theme, units);
    this.shadow.setStrength(theme.shadow);
  }

  castShadow(renderer: THREE.WebGLRenderer, object: THREE.Object3D): void {
    this.shadow.cast(renderer, object);
  }
}

function colorSky(geometry: THREE.PlaneGeometry, theme: Theme): void {
  const [upper, lower] = [srgb(theme.sky), srgb(theme.background)];
  const at = geometry.getAttribute("position");
  const colors = Array.from({ length: at.count }, (_, vertex) => {
    const share = ((at.getY(vertex) + 1) / 2) ** 1.5;
    return [...lower.map((value, channel) => value + share * (upper[channel]! - value)), 1];
  });
  geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(colors.flat()), 4));
}
