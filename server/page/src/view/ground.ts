import * as THREE from "three";
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

export function groundVisibility(distance_m: number): number {
  const share = Math.min(Math.max((distance_m - FADED_FROM_M) / (HALF_M - FADED_FROM_M), 0), 1);
  return 1 - share * share * (3 - 2 * share);
}

/** Ground of the scene: a lit disc and a grid of 5 cm, which fade away, with lengths beside the x axis. */
export class Ground {
  readonly group = new THREE.Group();
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
      const { geometry, material } = part as THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial>;
      geometry.dispose();
      material.map?.dispose();
      material.dispose();
    }
    this.group.clear();
  }
}

function disc(color: THREE.ColorRepresentation): THREE.Mesh {
  const geometry = new THREE.RingGeometry(0, HALF_M, 24, 8).translate(0, 0, DISC_Z_M);
  const mesh = new THREE.Mesh(faded(geometry, color), flatMaterial(true));
  mesh.renderOrder = -3;
  return mesh;
}

function grid(color: THREE.ColorRepresentation, major: boolean): THREE.LineSegments {
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
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
  const segments = new THREE.LineSegments(faded(geometry, color), flatMaterial(true));
  segments.renderOrder = -2;
  return segments;
}

function faded(geometry: THREE.BufferGeometry, color: THREE.ColorRepresentation): THREE.BufferGeometry {
  const at = geometry.getAttribute("position");
  const colors = Array.from({ length: at.count }, (_, index) => [...srgb(color), groundVisibility(Math.hypot(at.getX(index), at.getY(index)))]);
  return geometry.setAttribute("color", new THREE.Float32BufferAttribute(colors.flat(), 4));
}

function label(text: string, x_m: number, color: THREE.ColorRepresentation): THREE.Sprite {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = LABEL_PX;
  const context = canvas.getContext("2d");
  if (context !== null) {
    context.font = "500 34px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = new THREE.Color(color).getStyle();
    context.fillText(text, LABEL_PX[0] / 2, LABEL_PX[1] / 2);
  }
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, transparent: true, depthWrite: false }));
  sprite.scale.set((LABEL_HEIGHT_M * LABEL_PX[0]) / LABEL_PX[1], LABEL_HEIGHT_M, 1);
  sprite.position.set(x_m, LABEL_Y_M, 0.004);
  sprite.renderOrder = -1;
  return sprite;
}
