import { AmbientLight, AxesHelper, Color, DirectionalLight, GridHelper, Group, type Scene } from "three";
import type { Theme } from "./theme";

const GRID_SIZE_M = 1;
// One line each 5 cm: a length that one can read off.
const GRID_LINES = 20;
const AXES_LENGTH_M = 0.06;

/** Table, light and background. */
export class Surroundings {
  private readonly group = new Group();
  private grid: GridHelper | null = null;

  /** @param scene - what they are put into. */
  constructor(private readonly scene: Scene) {
    const sun = new DirectionalLight(0xffffff, 2.2);
    sun.position.set(0.6, -0.8, 1.4);
    const fill = new DirectionalLight(0xffffff, 0.7);
    fill.position.set(-1, 0.8, 0.4);
    const axes = new AxesHelper(AXES_LENGTH_M);
    // Above the grid, so that the two do not flicker.
    axes.position.z = 0.001;
    this.group.add(sun, fill, new AmbientLight(0xffffff, 1.1), axes);
    scene.add(this.group);
  }

  /** Takes other colours. */
  setTheme(theme: Theme): void {
    this.scene.background = new Color(theme.background);
    this.grid?.removeFromParent();
    this.grid?.dispose();
    this.grid = new GridHelper(GRID_SIZE_M, GRID_LINES, theme.grid_axis, theme.grid);
    // three's grid lies in x and z, as y is up there.
    this.grid.rotation.x = Math.PI / 2;
    this.group.add(this.grid);
  }
}
