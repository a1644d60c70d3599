import { BoxGeometry, Matrix4, Mesh, MeshLambertMaterial, Vector3, type BufferGeometry, type Object3D } from "three";
import { STLLoader } from "three/examples/jsm/loaders/STLLoader.js";
import { authorizationHeaders } from "../link/authentication";
import { fileKind, MESH_KINDS } from "../logic/scene-mesh";
import { t, type TextKey } from "../texts/texts";

/** Return the address of a mesh of a description; null for one outside of the robot's directory. */
export function meshUrl(uri: string, page: string): string | null {
  const path = uri.replace(/^package:\/\//, "");
  const base = new URL("robot/", page);
  try {
    const url = new URL(path, base);
    return url.href.startsWith(base.href) ? url.href : null;
  } catch {
    return null;
  }
}

// The server answers in milliseconds; a mesh that hangs must not delay its placeholder.
const MESH_TIMEOUT_MS = 20_000;
const REFUSALS: Record<number, TextKey> = {
  401: "picture.mesh.token",
  404: "picture.mesh.missing",
  413: "picture.mesh.too_large",
};
const PLACEHOLDER_EDGE_M = 0.03;

export class Meshes {
  private readonly known = new Map<string, Promise<Object3D>>();

  /**
   * @param failed - called with the sentence about each mesh that cannot be loaded.
   * @param missing_color - colour of its placeholder.
   */
  constructor(
    private readonly failed: (uri: string, text: string) => void,
    private readonly missing_color: number,
  ) {}

  /** Return a copy of a mesh; a small box when it cannot be loaded. */
  async get(uri: string): Promise<Object3D> {
    const template = this.known.get(uri) ?? this.load(uri);
    this.known.set(uri, template);
    return (await template).clone();
  }

  private async load(uri: string): Promise<Object3D> {
    try {
      return await fetchMesh(uri);
    } catch (error) {
      this.failed(uri, t("picture.mesh.failed", { uri, reason: (error as Error).message }));
      return placeholder(this.missing_color);
    }
  }
}

function placeholder(color: number): Mesh {
  const edge = PLACEHOLDER_EDGE_M;
  const mesh = new Mesh(new BoxGeometry(edge, edge, edge), new MeshLambertMaterial({ color }));
  mesh.name = "placeholder";
  return mesh;
}

async function fetchMesh(uri: string): Promise<Object3D> {
  const url = meshUrl(uri, document.baseURI);
  if (url === null) throw new Error(t("picture.mesh.elsewhere"));
  const answer = await fetch(url, { headers: authorizationHeaders(), signal: AbortSignal.timeout(MESH_TIMEOUT_MS) });
  if (!answer.ok) throw new Error(t(REFUSALS[answer.status] ?? "picture.mesh.status", { status: answer.status }));
  const kind = fileKind(new URL(url).pathname);
  if (!MESH_KINDS.some((known) => known === kind)) throw new Error(t("picture.mesh.kind", { kind, kinds: MESH_KINDS.join(", ") }));
  // The server sends no file above its own limit (server/robot_files.py).
  const bytes = await answer.arrayBuffer();
  let mesh: Object3D;
  try {
    mesh = await parseMesh(kind, url, bytes);
  } catch (error) {
    throw new Error(t("picture.mesh.broken", { kind, reason: (error as Error).message }));
  }
  if (!hasTriangles(mesh)) throw new Error(t("picture.mesh.no_triangles"));
  return mesh;
}

/**
 * Parse a mesh of one of MESH_KINDS; readers of the rarer kinds are loaded with their first file.
 *
 * @param url - address that a Collada file's own references are relative to.
 * @throws Error when it is none.
 */
async function parseMesh(kind: string, url: string, bytes: ArrayBuffer): Promise<Object3D> {
  if (kind === "stl") return new Mesh(new STLLoader().parse(bytes), new MeshLambertMaterial());
  const text = new TextDecoder().decode(bytes);
  if (kind === "obj") return new (await import("three/examples/jsm/loaders/OBJLoader.js")).OBJLoader().parse(text);
  const { ColladaLoader } = await import("three/examples/jsm/loaders/ColladaLoader.js");
  const collada = new ColladaLoader().parse(text, url.slice(0, url.lastIndexOf("/") + 1));
  if (collada === null) throw new Error(t("picture.mesh.empty"));
  return collada.scene;
}

function hasTriangles(mesh: Object3D): boolean {
  let corners = 0;
  mesh.traverse((node) => {
    if (node instanceof Mesh) corners += (node.geometry as BufferGeometry).getAttribute("position")?.count ?? 0;
  });
  return corners > 2;
}

/** Turn of y up, as three has Collada files, to z up. */
const Z_UP = new Matrix4().makeRotationX(Math.PI / 2);

/**
 * Return the corners of the triangles in a mesh file, nine coordinates each, in the unit of the file; Collada in metres.
 *
 * @throws Error when it is no file of its kind.
 */
export async function readCorners(name: string, bytes: ArrayBuffer): Promise<number[]> {
  const kind = fileKind(name);
  const object = await parseMesh(kind, "", bytes);
  object.updateMatrixWorld(true);
  const corners: number[] = [];
  const corner = new Vector3();
  object.traverse((node) => {
    if (!(node instanceof Mesh)) return;
    const matrix = kind === "dae" ? Z_UP.clone().multiply(node.matrixWorld) : node.matrixWorld;
    const { attributes: { position }, index } = node.geometry as BufferGeometry;
    const count = position === undefined ? 0 : (index?.count ?? position.count);
    for (let at = 0; at < count - (count % 3); at += 1) {
      corner.fromBufferAttribute(position!, index?.getX(at) ?? at).applyMatrix4(matrix);
      corners.push(corner.x, corner.y, corner.z);
    }
  });
  return corners;
}
