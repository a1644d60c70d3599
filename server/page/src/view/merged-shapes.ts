import { Matrix4, Mesh, type BufferGeometry, type Material, type Object3D } from "three";
import { mergeGeometries } from "three/examples/jsm/utils/BufferGeometryUtils.js";

/**
 * Merge the shapes of one link that have the same material into one mesh, in the place of the first of them.
 *
 * An arm of simple shapes has dozens of them, each of which costs a draw call, and another one for its shadow.
 *
 * @param shapes - shapes of the link, with their materials; only meshes without textures.
 */
export function mergeShapes(shapes: readonly Object3D[]): void {
  const alike = new Map<Material, Mesh[]>();
  for (const shape of shapes) {
    shape.updateWorldMatrix(true, true);
    shape.traverse((node) => {
      // The triangles of a mirrored shape would be turned inside out.
      if (!(node instanceof Mesh) || node.matrixWorld.determinant() < 0) return;
      const material = node.material as Material;
      alike.set(material, [...(alike.get(material) ?? []), node]);
    });
  }
  for (const meshes of alike.values()) merge(meshes);
}

function merge([first, ...others]: Mesh[]): void {
  if (first === undefined || others.length === 0) return;
  const to_first = new Matrix4().copy(first.matrixWorld).invert();
  const parts = [first, ...others].map((mesh) => {
    return plain(mesh.geometry).applyMatrix4(new Matrix4().multiplyMatrices(to_first, mesh.matrixWorld));
  });
  const merged = mergeGeometries(parts);
  for (const geometry of [...parts, ...[first, ...others].map((mesh) => mesh.geometry)]) geometry.dispose();
  first.geometry = merged;
  for (const mesh of others) mesh.removeFromParent();
}

/** Return a copy with positions and normals alone, by index, so that all shapes fit together. */
function plain(geometry: BufferGeometry): BufferGeometry {
  const copy = geometry.clone();
  copy.deleteAttribute("uv");
  if (copy.getIndex() === null) copy.setIndex([...Array(copy.getAttribute("position").count).keys()]);
  return copy;
}
