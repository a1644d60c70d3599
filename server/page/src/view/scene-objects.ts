import { Color, Group, Mesh, type Material, type MeshLambertMaterial, type Scene } from "three";
import type { SceneObject, State } from "../state/state";
import { quaternion, type Figure } from "./figure";
import type { Materials } from "./materials";
import { notice } from "./notices";
import type { PageStore, Part } from "./part";
import type { Robot } from "./robot";
import { shapeMesh } from "./shapes";

interface Drawn {
  object: SceneObject;
  group: Group;
}

/** Things of the planning scene, and what the arm holds. */
export class SceneObjects implements Part {
  private readonly drawn = new Map<string, Drawn>();
  private objects: SceneObject[] = [];
  private arm: Figure | null = null;

  /**
   * @param scene - what they are put into.
   * @param robot - whose links they may hang on.
   * @param store - where messages to the user go.
   * @param materials - how they are painted.
   */
  constructor(
    private readonly scene: Scene,
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const another = this.robot.arm !== this.arm;
    if (state.objects === this.objects && !another) return;
    this.arm = this.robot.arm;
    this.objects = state.objects;
    const left = new Map(state.objects.map((object) => [object.id, object]));
    for (const [id, { object }] of this.drawn) if (another || left.get(id) !== object) this.remove(id);
    for (const object of state.objects) if (!this.drawn.has(object.id)) this.show(object);
    const problems = state.objects.map((object) => this.frameProblem(object)).filter((text) => text !== "");
    notice(this.store, "frames", problems.join(" "));
  }

  /** What is drawn of the objects that stand around, for finding the one under a pointer. */
  standing(): Group[] {
    return [...this.drawn.values()].filter(({ object }) => !object.held).map(({ group }) => group);
  }

  private show(object: SceneObject): void {
    const group = new Group();
    group.name = object.id;
    group.position.set(...object.position_m);
    group.quaternion.copy(quaternion(object.orientation));
    const material = this.material(object);
    for (const shape of object.shapes) group.add(shapeMesh(shape, material));
    const link = this.arm?.robot.links[object.frame];
    (link ?? this.scene).add(group);
    this.drawn.set(object.id, { object, group });
  }

  private frameProblem(object: SceneObject): string {
    const known = this.arm === null || ["", "world"].includes(object.frame) || object.frame in this.arm.robot.links;
    return known ? "" : `The robot has no link “${object.frame}”: “${object.id}” is drawn from the root link.`;
  }

  private material(object: SceneObject): Material {
    if (object.color === null) return this.materials.object;
    const [red, green, blue, alpha] = object.color;
    const material: MeshLambertMaterial = this.materials.object.clone();
    material.color = new Color().setRGB(red, green, blue);
    // An alpha of 0 is what a message without one has; nobody asks for a thing that cannot be seen.
    material.opacity = alpha > 0 ? Math.min(alpha, 1) : 1;
    return material;
  }

  private remove(id: string): void {
    const drawn = this.drawn.get(id);
    drawn?.group.removeFromParent();
    drawn?.group.traverse((node) => {
      if (!(node instanceof Mesh)) return;
      node.geometry.dispose();
      if (node.material !== this.materials.object) (node.material as Material).dispose();
    });
    this.drawn.delete(id);
  }
}
