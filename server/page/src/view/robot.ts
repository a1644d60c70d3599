import type { Scene } from "three";
import { farthestLink, tipLink } from "../logic/description";
import type { State } from "../state/state";
import { readDescription, type Description } from "./description";
import { Figure, type Paint, type Shapes } from "./figure";
import type { Materials } from "./materials";
import { Meshes } from "./meshes";
import { clearNotices, notice } from "./notices";
import type { PageStore, Part } from "./part";
import type { Theme } from "./theme";

/** The robot that is shown: its description, and the figures that are drawn of it. */
export class Robot implements Part {
  /** The arm as it is; null until there is a description. */
  arm: Figure | null = null;
  /** The link whose way is shown and whose place is asked for. */
  tip = "";
  private description: Description | null = null;
  private meshes: Meshes | null = null;
  private urdf: string | null = null;
  private srdf: string | null = null;

  /**
   * @param scene - what the arm is put into.
   * @param store - where messages to the user go.
   * @param materials - how it is painted.
   * @param theme - gives the colours of the moment.
   * @param changed - called when a mesh has come, and with true when the robot is another.
   */
  constructor(
    private readonly scene: Scene,
    private readonly store: PageStore,
    private readonly materials: Materials,
    private readonly theme: () => Theme,
    private readonly changed: (another: boolean) => void,
  ) {}

  update(state: State): void {
    if (state.urdf !== this.urdf) this.take(state.urdf);
    if (state.srdf !== this.srdf || this.tip === "") this.findTip(state.srdf);
  }

  /** Another drawing of the same robot; null while there is none. */
  figure(shapes: Shapes, paint: Paint): Figure | null {
    if (this.description === null || this.meshes === null) return null;
    const figure = new Figure(this.description, this.meshes, shapes, paint, () => this.changed(false));
    this.scene.add(figure.robot);
    return figure;
  }

  private take(urdf: string | null): void {
    this.urdf = urdf;
    if (urdf === null) return;
    try {
      const description = readDescription(urdf);
      clearNotices(this.store, "mesh:");
      this.meshes = new Meshes((uri, text) => notice(this.store, `mesh:${uri}`, text), this.theme().missing);
      const before = this.arm;
      this.description = description;
      this.arm = this.figure("visual", this.materials.armPaint);
      before?.dispose();
      notice(this.store, "urdf", "");
    } catch (error) {
      const kept = this.arm === null ? "No arm is drawn" : "The arm before it is drawn still";
      notice(this.store, "urdf", `The robot description cannot be drawn: ${(error as Error).message}. ${kept}.`);
      return;
    }
    this.tip = "";
    this.changed(true);
  }

  private findTip(srdf: string | null): void {
    this.srdf = srdf;
    if (this.description === null) return;
    const told = tipLink(srdf);
    const known = told !== null && this.description.parts.links.includes(told);
    this.tip = known ? told : (farthestLink(this.description.parts) ?? "");
  }
}
