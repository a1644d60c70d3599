import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  CircleGeometry,
  Color,
  Group,
  LineSegments,
  Mesh,
  type MeshBasicMaterial,
  Sprite,
  SpriteMaterial,
  SRGBColorSpace,
  type ColorRepresentation,
} from "three";
import { distanceText, type UnitSystem } from "../logic/numbers";
import type { Theme } from "./appearance";
import { flatMaterial, srgb } from "./flat-material";

const MINOR_M = 0.05;
// Every second line is darker: 10 cm, which the labels name.
const MAJOR_EVERY = 2;
const HALF_M = 0.8;
// Shorter pieces fade away no more smoothly.
const LINES_A_PIECE = 4;
const FADED_FROM_M = 0.25;
const LABELS_M = [0.2, 0.4];
const LABEL_HEIGHT_M = 0.018;
// Beside the arm, on its nearer side.
const LABEL_Y_M = -0.125;
const LABEL_PX: [number, number] = [144, 48];
// Below what stands on z = 0, in this order, so that nothing flickers.
const DISC_Z_M = -0.003;
const GRID_Z_M = -0.002;

/** Return the visibility of the ground at a distance from the origin: 1 near, 0 at its edge. */
export function groundVisibility(distance_m: number): number {
  const share = Math.min(Math.max((distance_m - FADED_FROM_M) / (HALF_M - FADED_FROM_M), 0), 1);
  return 1 - share * share * (3 - 2 * share);
}

/** Ground of the scene: a lit disc and a grid of 5 cm, which fade away, with lengths beside the x axis. */
export class Ground {
  /** Object to add to a scene. */
  readonly group = new Group();
  private theme: Theme | null = null;
  private units: UnitSystem | null = null;

  /** Apply other colours, and other units of the lengths. */
  setTheme(theme: Theme, units: UnitSystem): void {
    if (theme === this.theme && units === this.units) return;
    this.theme = theme;
    this.units = units;
    this.clear();
    this.group.add(disc(theme.ground), grid(theme.grid, false), grid(theme.grid_axis, true));
    for (const x_m of LABELS_M) this.group.add(label(distanceText(x_m, units), x_m, theme.grid_label));
  }

  private clear(): void {
    for (const part of this.group.children) {
      const { geometry, material } = part as Mesh<BufferGeometry, MeshBasicMaterial>;
      geometry.dispose();
      material.map?.dispose();
      material.dispose();
    }
    this.group.clear();
  }
}

function disc(color: ColorRepresentation): Mesh {
  const geometry = new BufferGeometry();
  const rings = 8;
  const segments = 40;
  const at: number[] = [];
  for (let ring = 0; ring < rings; ring += 1) {
    const part = new CircleGeometry(1, segments).getAttribute("position");
    const [inner, outer] = [(HALF_M * ring) / rings, (HALF_M * (ring + 1)) / rings];
    for (let side = 1; side <= segments; side += 1) {
      const [a_x, a_y, b_x, b_y] = [part.getX(side), part.getY(side), part.getX(side + 1), part.getY(side + 1)];
      const corner = (x: number, y: number, radius: number): number[] => [x * radius, y * radius, DISC_Z_M];
      at.push(...corner(a_x, a_y, inner), ...corner(a_x, a_y, outer), ...corner(b_x, b_y, outer));
      if (ring > 0) at.push(...corner(a_x, a_y, inner), ...corner(b_x, b_y, outer), ...corner(b_x, b_y, inner));
    }
  }
  setFading(geometry, at, color);
  const mesh = new Mesh(geometry, flatMaterial(true));
  mesh.renderOrder = -3;
  return mesh;
}

function grid(color: ColorRepresentation, major: boolean): LineSegments {
  const at: number[] = [];
  const count = Math.round(HALF_M / MINOR_M);
  const lines = Array.from({ length: 2 * count + 1 }, (_, index) => index - count);
  for (const line of lines.filter((index) => (index % MAJOR_EVERY === 0) === major)) {
    // The colour is interpolated between the ends of a piece.
    for (let piece = -count; piece < count; piece += LINES_A_PIECE) {
      const [across, from, to] = [line * MINOR_M, piece * MINOR_M, (piece + LINES_A_PIECE) * MINOR_M];
      at.push(across, from, GRID_Z_M, across, to, GRID_Z_M, from, across, GRID_Z_M, to, across, GRID_Z_M);
    }
  }
  const geometry = new BufferGeometry();
  setFading(geometry, at, color);
  const segments = new LineSegments(geometry, flatMaterial(true));
  segments.renderOrder = -2;
  return segments;
}

function setFading(geometry: BufferGeometry, at: number[], color: ColorRepresentation): void {
  const [r, g, b] = srgb(color);
  const colors: number[] = [];
  for (let index = 0; index < at.length; index += 3) {
    colors.push(r, g, b, groundVisibility(Math.hypot(at[index] ?? 0, at[index + 1] ?? 0)));
  }
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(at), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colors), 4));
}

function label(text: string, x_m: number, color: ColorRepresentation): Sprite {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = LABEL_PX;
  const context = canvas.getContext("2d");
  if (context !== null) {
    context.font = "500 34px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = new Color(color).getStyle();
    context.fillText(text, LABEL_PX[0] / 2, LABEL_PX[1] / 2);
  }
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, transparent: true, depthWrite: false }));
  sprite.scale.set((LABEL_HEIGHT_M * LABEL_PX[0]) / LABEL_PX[1], LABEL_HEIGHT_M, 1);
  sprite.position.set(x_m, LABEL_Y_M, 0.004);
  sprite.renderOrder = -1;
  return sprite;
}
