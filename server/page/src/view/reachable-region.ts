import { DynamicDrawUsage, InstancedMesh, Matrix4, MeshBasicMaterial, Color, DoubleSide, PlaneGeometry, Quaternion, Vector3, type Scene } from "three";
import type { Cell, Slice, State } from "../state/state";
import type { SceneComponent } from "./viewer";

const COLORS: Record<Exclude<Cell["reach"], "out">, Color> = { free: new Color(0x2fa36b), contact: new Color(0xe08a1e) };

const MAX_SQUARES = 1024;

const FILLED = 0.86;

/** Reachable region of the tip on a slice: squares, all in one draw call. */
export class ReachableRegion implements SceneComponent {
  private mesh: InstancedMesh | null = null;
  private cells: readonly Cell[] = [];

  constructor(private readonly scene: Scene) {}

  update({ region }: State): void {
    if (region.cells === this.cells) return;
    const drawn = this.cells;
    // Cells that are added to those before leave the squares before as they are.
    const from = drawn.length > 0 && region.cells[drawn.length - 1] === drawn.at(-1) ? drawn.length : 0;
    this.cells = region.cells;
    if (region.cells.length === 0 && this.mesh === null) return;
    this.mesh ??= this.create();
    if (from === 0) this.mesh.count = 0;
    const turn = orientationOf(region.slice);
    for (const cell of region.cells.slice(from)) this.add(this.mesh, cell, turn);
    this.mesh.instanceMatrix.needsUpdate = true;
    if (this.mesh.instanceColor) this.mesh.instanceColor.needsUpdate = true;
  }

  private add(mesh: InstancedMesh, { point_m, edge_m, reach }: Cell, turn: Quaternion): void {
    if (reach === "out" || mesh.count >= MAX_SQUARES) return;
    const edge = edge_m * FILLED;
    const matrix = new Matrix4().compose(new Vector3(...point_m), turn, new Vector3(edge, edge, 1));
    mesh.setMatrixAt(mesh.count, matrix);
    mesh.setColorAt(mesh.count, COLORS[reach]);
    mesh.count += 1;
  }

  private create(): InstancedMesh {
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.45, side: DoubleSide, depthWrite: false });
    const mesh = new InstancedMesh(new PlaneGeometry(1, 1), material, MAX_SQUARES);
    mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    // Its bounds are those of the first square, while the squares are all over the picture.
    mesh.frustumCulled = false;
    mesh.raycast = () => undefined;
    this.scene.add(mesh);
    return mesh;
  }
}

/** Return the turn that lays a square, which three has in x and y, into a slice. */
function orientationOf({ kind, angle_rad }: Slice): Quaternion {
  if (kind === "level") return new Quaternion();
  const about_z = new Quaternion().setFromAxisAngle(new Vector3(0, 0, 1), angle_rad);
  return about_z.multiply(new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), Math.PI / 2));
}
