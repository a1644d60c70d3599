import { BoxGeometry, Mesh, MeshLambertMaterial, type BufferGeometry, type Object3D } from "three";
import { STLLoader } from "three/examples/jsm/loaders/STLLoader.js";
import { authorizationHeaders } from "../link/authentication";
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

/** Read a response up to a limit, which bounds the memory; throw beyond it. */
export async function readBounded(answer: Response, limit_bytes: number): Promise<Uint8Array<ArrayBuffer>> {
  const declared_bytes = Number(answer.headers.get("content-length") ?? 0);
  if (declared_bytes > limit_bytes) {
    await answer.body?.cancel();
    throw tooLarge(declared_bytes, limit_bytes);
  }
  const reader = answer.body?.getReader();
  const chunks: Uint8Array[] = [];
  let size_bytes = 0;
  for (let part = await reader?.read(); part?.value !== undefined; part = await reader?.read()) {
    chunks.push(part.value);
    size_bytes += part.value.length;
    // Content-Length of a compressed file is the size before decompression.
    if (size_bytes > limit_bytes) {
      await reader?.cancel();
      throw tooLarge(size_bytes, limit_bytes);
    }
  }
  return concatenate(chunks, size_bytes);
}

function concatenate(chunks: Uint8Array[], size_bytes: number): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(size_bytes);
  let at = 0;
  for (const chunk of chunks) {
    whole.set(chunk, at);
    at += chunk.length;
  }
  return whole;
}

function tooLarge(size_bytes: number, limit_bytes: number): Error {
  const mb = (bytes: number): string => `${Math.ceil(bytes / 1e6)} MB`;
  return new Error(t("picture.mesh.large", { limit: mb(limit_bytes), size: mb(size_bytes) }));
}

// The largest mesh of SO-101 has 3 MB; beyond 30 MB a browser is busy for seconds, and a phone fails.
const MESH_LIMIT_BYTES = 30_000_000;
const KINDS = ["stl", "dae", "obj"];
// The server answers in milliseconds; a mesh that hangs must not delay its placeholder.
const MESH_TIMEOUT_MS = 20_000;
const REFUSALS: Record<number, TextKey> = {
  401: "picture.mesh.token",
  404: "picture.mesh.missing",
  413: "picture.mesh.too_large",
};
const PLACEHOLDER_EDGE_M = 0.03;

/** Callback with the sentence about a mesh that could not be loaded. */
type MeshFailed = (uri: string, text: string) => void;

/** Cache of meshes, each of which is fetched once. */
export class Meshes {
  private readonly known = new Map<string, Promise<Object3D>>();

  /**
   * @param failed - called for each mesh that cannot be loaded.
   * @param missing_color - colour of its placeholder.
   */
  constructor(
    private readonly failed: MeshFailed,
    private readonly missing_color: number,
  ) {}

  /** Return a copy of a mesh; a small box when it cannot be loaded. */
  async get(uri: string): Promise<Object3D> {
    let template = this.known.get(uri);
    if (template === undefined) {
      template = this.load(uri);
      this.known.set(uri, template);
    }
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
  return readMesh(url, await readBounded(answer, MESH_LIMIT_BYTES));
}

async function readMesh(url: string, bytes: Uint8Array<ArrayBuffer>): Promise<Object3D> {
  const kind = new URL(url).pathname.split(".").at(-1)?.toLowerCase() ?? "";
  if (!KINDS.includes(kind)) throw new Error(t("picture.mesh.kind", { kind, kinds: KINDS.join(", ") }));
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
 * Parse a mesh of the kind "stl", "obj" or "dae"; readers of the rarer kinds are loaded with their first file.
 *
 * @param url - address that a Collada file's own references are relative to.
 * @throws Error when it is none.
 */
export async function parseMesh(kind: string, url: string, bytes: Uint8Array<ArrayBuffer>): Promise<Object3D> {
  if (kind === "stl") return new Mesh(new STLLoader().parse(bytes.buffer), new MeshLambertMaterial());
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
