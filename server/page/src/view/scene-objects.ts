import * as THREE from "three";
import type { Point, SceneObject, Shape, State } from "../state/state";
import { setNotice, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Materials } from "./appearance";
import type { Robot } from "./robot";
import { toQuaternion, type RobotModel } from "./robot-model";
import type { SceneComponent } from "./viewer";

const SEGMENTS = 24;
// Edge of the piece of an infinite plane that is drawn, as large as the table.
const PLANE_EDGE_M = 1;
const PLANE_NORMAL = new THREE.Vector3(0, 0, 1);

export function shapeMesh(shape: Shape, material: THREE.Material): THREE.Mesh {
  const mesh = new THREE.Mesh(geometryOf(shape), material);
  mesh.position.set(...shape.position_m);
  mesh.quaternion.copy(toQuaternion(shape.orientation));
  return mesh;
}

function geometryOf(shape: Shape): THREE.BufferGeometry {
  const [first = 0, second = 0, third = 0] = shape.dimensions;
  switch (shape.kind) {
    case "box":
      return new THREE.BoxGeometry(first, second, third);
    case "sphere":
      return new THREE.SphereGeometry(first, SEGMENTS, SEGMENTS / 2);
    // Cylinders of three stand along y, those of ROS along z, with the height before the radius.
    case "cylinder":
      return new THREE.CylinderGeometry(second, second, first, SEGMENTS).rotateX(Math.PI / 2);
    case "cone":
      return new THREE.ConeGeometry(second, first, SEGMENTS).rotateX(Math.PI / 2);
    case "plane":
      return plane(shape.dimensions);
    case "prism":
      return prism(shape.vertices, first);
    case "mesh":
      return surface(shape);
  }
}

/** Lay a plane a x + b y + c z + d = 0 about its point that is nearest to the origin. */
function plane([a = 0, b = 0, c = 1, d = 0]: number[]): THREE.BufferGeometry {
  const { normal, constant } = new THREE.Plane(new THREE.Vector3(a, b, c), d).normalize();
  const turn = new THREE.Quaternion().setFromUnitVectors(PLANE_NORMAL, normal);
  const [x, y, z] = normal.clone().multiplyScalar(-constant).toArray();
  return new THREE.PlaneGeometry(PLANE_EDGE_M, PLANE_EDGE_M).applyQuaternion(turn).translate(x, y, z);
}

/** Stand a prism on its polygon, half its height below and above it. */
function prism(polygon: Point[], height_m: number): THREE.BufferGeometry {
  const outline = new THREE.Shape(polygon.map(([x, y]) => new THREE.Vector2(x, y)));
  return new THREE.ExtrudeGeometry(outline, { depth: height_m, bevelEnabled: false }).translate(0, 0, -height_m / 2);
}

function surface({ vertices, triangles }: Shape): THREE.BufferGeometry {
  // Corners are not shared, so that edges look sharp.
  const corners = triangles.flat().flatMap((index) => vertices[index] ?? [0, 0, 0]);
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  geometry.computeVertexNormals();
  return geometry;
}

interface Drawn {
  object: SceneObject;
  group: THREE.Group;
}

export class SceneObjects implements SceneComponent {
  private readonly drawn = new Map<string, Drawn>();
  private objects: SceneObject[] = [];
  private arm: RobotModel | null = null;

  constructor(
    private readonly scene: THREE.Scene,
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const is_new_arm = this.robot.arm !== this.arm;
    if (state.objects === this.objects && !is_new_arm) return;
    this.arm = this.robot.arm;
    this.objects = state.objects;
    const present = new Map(state.objects.map((object) => [object.id, object]));
    for (const [id, { object }] of this.drawn) if (is_new_arm || present.get(id) !== object) this.remove(id);
    for (const object of state.objects) if (!this.drawn.has(object.id)) this.show(object);
    const problems = state.objects.map((object) => this.frameProblem(object)).filter((text) => text !== "");
    setNotice(this.store, "view:frames", problems.join(" "));
  }

  worldObjects(): THREE.Group[] {
    return [...this.drawn.values()].filter(({ object }) => !object.attached).map(({ group }) => group);
  }

  private show(object: SceneObject): void {
    const group = new THREE.Group();
    group.name = object.id;
    group.position.set(...object.position_m);
    group.quaternion.copy(toQuaternion(object.orientation));
    const material = this.material(object);
    for (const shape of object.shapes) group.add(shapeMesh(shape, material));
    const link = this.arm?.robot.links[object.frame];
    (link ?? this.scene).add(group);
    this.drawn.set(object.id, { object, group });
  }

  private frameProblem(object: SceneObject): string {
    const is_known = this.arm === null || ["", "world"].includes(object.frame) || object.frame in this.arm.robot.links;
    return is_known ? "" : t("picture.object.no_link", { link: object.frame, name: object.id });
  }

  private material(object: SceneObject): THREE.Material {
    if (object.color === null) return this.materials.object;
    const [red, green, blue, alpha] = object.color;
    const material: THREE.MeshLambertMaterial = this.materials.object.clone();
    material.color = new THREE.Color().setRGB(red, green, blue);
    // Messages that leave out alpha have 0; an invisible object is never meant.
    material.opacity = alpha > 0 ? Math.min(alpha, 1) : 1;
    return material;
  }

  private remove(id: string): void {
    const drawn = this.drawn.get(id);
    drawn?.group.removeFromParent();
    drawn?.group.traverse((node) => {
      if (!(node instanceof THREE.Mesh)) return;
      node.geometry.dispose();
      if (node.material !== this.materials.object) (node.material as THREE.Material).dispose();
    });
    this.drawn.delete(id);
  }
}
