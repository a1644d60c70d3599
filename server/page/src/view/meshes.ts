import { BoxGeometry, Mesh, MeshLambertMaterial, type BufferGeometry, type Object3D } from "three";
import { ColladaLoader } from "three/examples/jsm/loaders/ColladaLoader.js";
import { OBJLoader } from "three/examples/jsm/loaders/OBJLoader.js";
import { STLLoader } from "three/examples/jsm/loaders/STLLoader.js";
import { meshUrl } from "../logic/description";
import { readBounded } from "../logic/bounded-read";
import { bearer } from "../state/token";

// The largest mesh of SO-101 has 3 MB; beyond this a browser is busy for seconds and a phone gives up.
const MESH_LIMIT_BYTES = 30_000_000;
const KINDS = ["stl", "dae", "obj"];
// The server answers in milliseconds; a mesh that hangs must not keep its placeholder from being drawn.
const MESH_TIMEOUT_MS = 20_000;
const REFUSALS: Record<number, string> = {
  401: "the server wants a token for it",
  404: "the server does not have it",
  413: "larger than the server gives away",
};
const PLACEHOLDER_EDGE_M = 0.03;

/** Tells of a mesh that could not be had; an empty sentence when it could. */
type MeshNews = (uri: string, text: string) => void;

/** Fetches meshes, each once, however often it is shown. */
export class Meshes {
  private readonly known = new Map<string, Promise<Object3D>>();

  /**
   * @param news - told of every mesh that could not be had.
   * @param missing_color - what is drawn in its place.
   */
  constructor(
    private readonly news: MeshNews,
    private readonly missing_color: number,
  ) {}

  /** The mesh of that name, to be added to a scene; a small box when it cannot be had. */
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
      this.news(uri, `${uri}: ${(error as Error).message}. A box is drawn in its place.`);
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
  if (url === null) throw new Error("not below the robot's directory");
  const answer = await fetch(url, { headers: bearer(), signal: AbortSignal.timeout(MESH_TIMEOUT_MS) });
  if (!answer.ok) throw new Error(REFUSALS[answer.status] ?? `the server answers with ${answer.status}`);
  return readMesh(url, await readBounded(answer, MESH_LIMIT_BYTES));
}

function readMesh(url: string, bytes: Uint8Array<ArrayBuffer>): Object3D {
  const kind = new URL(url).pathname.split(".").at(-1)?.toLowerCase() ?? "";
  if (!KINDS.includes(kind)) throw new Error(`a file of kind "${kind}": ${KINDS.join(", ")} can be drawn`);
  let mesh: Object3D;
  try {
    mesh = parseMesh(kind, url, bytes);
  } catch (error) {
    throw new Error(`it is no ${kind} file (${(error as Error).message})`);
  }
  if (!hasTriangles(mesh)) throw new Error("there are no triangles in it");
  return mesh;
}

function parseMesh(kind: string, url: string, bytes: Uint8Array<ArrayBuffer>): Object3D {
  if (kind === "stl") return new Mesh(new STLLoader().parse(bytes.buffer), new MeshLambertMaterial());
  const text = new TextDecoder().decode(bytes);
  if (kind === "obj") return new OBJLoader().parse(text);
  const collada = new ColladaLoader().parse(text, url.slice(0, url.lastIndexOf("/") + 1));
  if (collada === null) throw new Error("nothing in it");
  return collada.scene;
}

function hasTriangles(mesh: Object3D): boolean {
  let corners = 0;
  mesh.traverse((node) => {
    if (node instanceof Mesh) corners += (node.geometry as BufferGeometry).getAttribute("position")?.count ?? 0;
  });
  return corners > 2;
}
