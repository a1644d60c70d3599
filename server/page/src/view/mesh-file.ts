import { Matrix4, Mesh, Vector3, type BufferGeometry } from "three";
import { fileKind } from "../logic/scene-mesh";
import { parseMesh } from "./meshes";

/** Turn of y up, as three has Collada files, to z up. */
const Z_UP = new Matrix4().makeRotationX(Math.PI / 2);

/**
 * Return the corners of the triangles in a mesh file, nine coordinates each, in the unit of the file; Collada in metres.
 *
 * @throws Error when it is no file of its kind.
 */
export async function readCorners(name: string, bytes: ArrayBuffer): Promise<number[]> {
  const kind = fileKind(name);
  const object = await parseMesh(kind, "", new Uint8Array(bytes));
  object.updateMatrixWorld(true);
  const corners: number[] = [];
  object.traverse((node) => {
    if (!(node instanceof Mesh)) return;
    const matrix = kind === "dae" ? Z_UP.clone().multiply(node.matrixWorld) : node.matrixWorld;
    appendCorners(corners, node.geometry as BufferGeometry, matrix);
  });
  return corners;
}

function appendCorners(corners: number[], geometry: BufferGeometry, matrix: Matrix4): void {
  const position = geometry.getAttribute("position");
  if (position === undefined) return;
  const index = geometry.getIndex();
  const count = index?.count ?? position.count;
  const corner = new Vector3();
  for (let at = 0; at < count - (count % 3); at += 1) {
    corner.fromBufferAttribute(position, index?.getX(at) ?? at).applyMatrix4(matrix);
    corners.push(corner.x, corner.y, corner.z);
  }
}
