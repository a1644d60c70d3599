import { Box3, Object3D, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Point } from "../state/state";
import { openGraphics } from "./graphics";

const FIELD_OF_VIEW_DEG = 40;
const NEAR_M = 0.01;
const FAR_M = 20;
// More pixels than this cost time and show nothing that the eye finds on a phone.
const MAX_PIXEL_RATIO = 2;
// The arm at rest is smaller than the space that it moves in.
const MARGIN = 1.15;
// Seen around the place of the arm before there is one.
const TABLE_RADIUS_M = 0.3;
// From the front and the side, above the table.
const VIEW_DIRECTION = new Vector3(0.75, -0.85, 0.55).normalize();

// A little from below, as under a table's edge; from further down the table hides nothing and confuses.
const LOWEST_VIEW_RAD = 1.75;

/** Draws a scene on a canvas, and only when somebody asked for it. */
export class Viewer {
  /** What is drawn. */
  readonly scene = new Scene();
  /** z is up, as in ROS. */
  readonly camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, NEAR_M, FAR_M);
  /** Turning, moving and zooming by mouse or finger. */
  readonly orbit: OrbitControls;
  /** What is drawn on: the canvas that was given, or one in its place. */
  readonly canvas: HTMLCanvasElement;
  private readonly renderer: WebGLRenderer;
  private readonly sizes: ResizeObserver;
  private frame_id = 0;
  private framed: Object3D | null = null;

  /**
   * @param given - a canvas to draw on; its size is that of its box in the page.
   * @param prepare - called before each frame, brings the scene up to date.
   * @param drawn - called after each frame.
   * @throws Error when the browser has no WebGL.
   */
  constructor(
    given: HTMLCanvasElement,
    private readonly prepare: () => void,
    private readonly drawn: () => void,
  ) {
    const { canvas, context } = openGraphics(given);
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, context });
    // Asking each program for its errors makes the page wait until it is built, one after the other.
    this.renderer.debug.checkShaderErrors = false;
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.maxPolarAngle = LOWEST_VIEW_RAD;
    this.orbit.addEventListener("change", () => this.request());
    // From then on the user's own view is kept, also when the window gets another size.
    this.orbit.addEventListener("start", () => (this.framed = null));
    canvas.addEventListener("webglcontextrestored", () => this.request());
    this.fit();
    // The table is seen while there is no arm.
    this.look(new Vector3(), TABLE_RADIUS_M);
    this.sizes = new ResizeObserver(() => {
      this.fit();
      if (this.framed !== null) this.frame(this.framed);
      // At once: a canvas that was resized is empty until it is drawn again.
      this.draw();
    });
    this.sizes.observe(canvas);
  }

  /** Asks for one frame; asking again before it costs nothing. */
  request(): void {
    if (this.frame_id === 0) this.frame_id = requestAnimationFrame(() => this.draw());
  }

  /** Draws at once, for pictures of the canvas. */
  draw(): void {
    cancelAnimationFrame(this.frame_id);
    this.frame_id = 0;
    this.prepare();
    this.renderer.render(this.scene, this.camera);
    this.drawn();
  }

  /** Turns the camera so that a thing fills the picture. */
  frame(thing: Object3D): void {
    const box = new Box3().setFromObject(thing);
    if (box.isEmpty()) return;
    this.framed = thing;
    this.look(box.getCenter(new Vector3()), box.getSize(new Vector3()).length() / 2);
    this.request();
  }

  /** The first of some things under a pointer; null when there is none. */
  pick(event: PointerEvent, things: Object3D[]): Object3D | null {
    const box = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1;
    const y = 1 - ((event.clientY - box.top) / box.height) * 2;
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.camera);
    let hit = ray.intersectObjects(things, true)[0]?.object ?? null;
    while (hit !== null && !things.includes(hit)) hit = hit.parent;
    return hit;
  }

  /** Where a point is seen, in pixels from the page's upper left corner. */
  screenOf(point_m: Point): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    const seen = new Vector3(...point_m).project(this.camera);
    return [box.left + ((seen.x + 1) / 2) * box.width, box.top + ((1 - seen.y) / 2) * box.height];
  }

  /** Frees what the graphics hold. */
  dispose(): void {
    cancelAnimationFrame(this.frame_id);
    this.sizes.disconnect();
    this.orbit.dispose();
    this.renderer.dispose();
  }

  private look(center: Vector3, radius_m: number): void {
    const half_rad = (FIELD_OF_VIEW_DEG * Math.PI) / 360;
    const narrow = Math.min(1, this.camera.aspect);
    const distance_m = (radius_m * MARGIN) / (Math.sin(half_rad) * narrow);
    this.orbit.target.copy(center);
    this.camera.position.copy(center).addScaledVector(VIEW_DIRECTION, distance_m);
    this.orbit.update();
  }

  private fit(): void {
    const width = Math.max(1, this.canvas.clientWidth);
    const height = Math.max(1, this.canvas.clientHeight);
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }
}
