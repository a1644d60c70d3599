import { Box3, Matrix3, type Object3D, PerspectiveCamera, Plane, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Point, State, SurfacePoint } from "../state/state";
import { t } from "../texts/texts";

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

export interface Graphics {
  canvas: HTMLCanvasElement;
  context: WebGL2RenderingContext;
  /** True when it is drawn by the processor. */
  in_software: boolean;
}

/**
 * Create the WebGL context of a canvas: with antialiasing on a graphics card, without it in software.
 *
 * Antialiasing in software costs a third of the frames. Only a context tells its renderer, and one in software is slow
 * to create, so that one is kept; on a graphics card the canvas is replaced by a copy.
 *
 * @throws Error when the browser has no WebGL.
 */
export function openGraphics(canvas: HTMLCanvasElement): Graphics {
  const plain = contextOf(canvas, false);
  if (SOFTWARE.test(rendererName(plain))) return { canvas, context: plain, in_software: true };
  const smooth = canvas.cloneNode(false) as HTMLCanvasElement;
  canvas.replaceWith(smooth);
  plain.getExtension("WEBGL_lose_context")?.loseContext();
  return { canvas: smooth, context: contextOf(smooth, true), in_software: false };
}

function contextOf(canvas: HTMLCanvasElement, antialias: boolean): WebGL2RenderingContext {
  // Without an alpha channel the browser need not blend the picture with the page.
  const context = canvas.getContext("webgl2", { alpha: false, depth: true, stencil: false, antialias });
  if (context === null) throw new Error(t("picture.no_webgl"));
  return context;
}

function rendererName(context: WebGL2RenderingContext): string {
  const names = context.getExtension("WEBGL_debug_renderer_info");
  return String(context.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
}

/** Component of the scene, which is updated from the state before each frame. */
export interface SceneComponent {
  update(state: State): void;
}

const FIELD_OF_VIEW_DEG = 40;
const FIELD_OF_VIEW_RAD = (FIELD_OF_VIEW_DEG * Math.PI) / 180;
const NEAR_M = 0.01;
const FAR_M = 20;
// More pixels cost time and make no visible difference on a phone.
const MAX_PIXEL_RATIO = 2;
// In software a frame costs by its pixels: what moves is drawn with so many, and again with all once it rests. Where frames
// come late (beside a load of 12 to 15 on two cores, 8 to 11 a second) fewer pixels give a fifth to a third more frames.
const MOVING_PIXELS = 170_000;
const LATE_PIXELS = 70_000;
const LATE_MS = 40;
const AT_REST_MS = 1500;
// Part of the picture that the arm fills: it moves in more space than it takes at rest.
const FILLED = 0.86;
// Radius of the table that is shown while there is no arm.
const TABLE_RADIUS_M = 0.3;
// From the front and the side, above the table.
const VIEW_DIRECTION = new Vector3(0.75, -0.85, 0.55).normalize();

// Ground that objects stand on: the plane z = 0 of the root link.
const GROUND = new Plane(new Vector3(0, 0, 1), 0);
// Farthest point of the ground that counts: near the horizon a click has no certain place.
const MAX_DISTANCE_M = 2;
// A little below the table's edge; from further down the grid hides nothing and confuses.
const MAX_POLAR_ANGLE_RAD = 1.75;

/** Viewer that draws a scene on a canvas, only on request. */
export class Viewer {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, NEAR_M, FAR_M);
  readonly orbit: OrbitControls;
  /** Canvas that is drawn on: the given one, or its copy. */
  readonly canvas: HTMLCanvasElement;
  /** Part of the canvas that no panel covers, in which objects are framed. */
  private readonly free: HTMLElement;
  private readonly renderer: WebGLRenderer;
  private readonly in_software: boolean;
  private pixel_share = 1;
  private moving_pixels = MOVING_PIXELS;
  /** Mean time from a request to its frame, of the last ten or so. */
  private late_ms = 0;
  // The first frames are coarse too, so that the arm is seen soon.
  private drawn_ms = 0;
  private rest_timer: ReturnType<typeof setTimeout> | undefined;
  private frame_id = 0;
  private framed: Object3D | null = null;

  /**
   * @param given - canvas to draw on; its size is that of its box in the page, and its parent is what no panel covers.
   * @param prepare - called before each frame, to update the scene.
   * @param drawn - called after each frame.
   * @throws Error when the browser has no WebGL.
   */
  constructor(
    given: HTMLCanvasElement,
    private readonly prepare: (renderer: WebGLRenderer) => void,
    private readonly drawn: () => void,
  ) {
    const { canvas, context, in_software } = openGraphics(given);
    this.canvas = canvas;
    this.free = canvas.parentElement ?? canvas;
    this.in_software = in_software;
    this.renderer = new WebGLRenderer({ canvas, context });
    // Checking each shader program for errors would wait for its compilation, one after the other.
    this.renderer.debug.checkShaderErrors = false;
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.maxPolarAngle = MAX_POLAR_ANGLE_RAD;
    this.orbit.addEventListener("change", () => this.request());
    // After the user has moved the camera it stays, also when the window is resized.
    this.orbit.addEventListener("start", () => (this.framed = null));
    canvas.addEventListener("webglcontextrestored", () => this.request());
    this.fit();
    // The table is seen while there is no arm.
    const corner = new Vector3(TABLE_RADIUS_M, TABLE_RADIUS_M, 0);
    this.look(new Box3(corner.clone().negate(), corner));
    const resized = new ResizeObserver(() => {
      this.fit();
      if (this.framed !== null) this.frame(this.framed);
      // At once, as a resized canvas is empty until it is drawn.
      this.draw();
    });
    resized.observe(canvas);
    resized.observe(this.free);
  }

  request(): void {
    const requested_ms = performance.now();
    if (this.frame_id !== 0) return;
    this.frame_id = requestAnimationFrame(() => {
      this.late_ms += 0.1 * (performance.now() - requested_ms - this.late_ms);
      this.draw();
    });
  }

  /** Move the camera so that an object fills the picture. */
  frame(object: Object3D): void {
    const box = new Box3().setFromObject(object);
    if (box.isEmpty()) return;
    this.framed = object;
    this.look(box);
    this.request();
  }

  /** Return the first of some objects under a pointer; null without any. */
  pick(event: PointerEvent, objects: Object3D[]): Object3D | null {
    let hit = this.rayThrough(event).intersectObjects(objects, true)[0]?.object ?? null;
    while (hit !== null && !objects.includes(hit)) hit = hit.parent;
    return hit;
  }

  /** Return the nearest surface under a pointer, of some objects or the ground; null where there is none. */
  surfaceAt(event: PointerEvent, objects: Object3D[]): SurfacePoint | null {
    const ray = this.rayThrough(event);
    const hit = ray.intersectObjects(objects, true)[0];
    if (hit?.face) {
      const normal = hit.face.normal.clone().applyNormalMatrix(new Matrix3().getNormalMatrix(hit.object.matrixWorld));
      // A mesh may have its triangles the other way round.
      if (normal.dot(ray.ray.direction) > 0) normal.negate();
      return { point_m: hit.point.toArray(), normal: normal.toArray() };
    }
    const point = ray.ray.intersectPlane(GROUND, new Vector3());
    if (point === null || point.length() > MAX_DISTANCE_M) return null;
    return { point_m: point.toArray(), normal: [0, 0, 1] };
  }

  private rayThrough({ clientX, clientY }: PointerEvent): Raycaster {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(((clientX - left) / width) * 2 - 1, 1 - ((clientY - top) / height) * 2), this.camera);
    return ray;
  }

  screenOf(point_m: Point): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    const projected = new Vector3(...point_m).project(this.camera);
    return [box.left + ((projected.x + 1) / 2) * box.width, box.top + ((1 - projected.y) / 2) * box.height];
  }

  private draw(): void {
    cancelAnimationFrame(this.frame_id);
    this.frame_id = 0;
    if (this.in_software) this.choosePixels();
    this.prepare(this.renderer);
    this.renderer.render(this.scene, this.camera);
    this.drawn();
  }

  private choosePixels(): void {
    const now_ms = performance.now();
    const is_moving = now_ms - this.drawn_ms < AT_REST_MS;
    this.drawn_ms = now_ms;
    clearTimeout(this.rest_timer);
    if (is_moving) this.rest_timer = setTimeout(() => this.request(), AT_REST_MS);
    const pixels = this.canvas.clientWidth * this.canvas.clientHeight;
    // Until it rests: with fewer pixels frames are no longer late.
    if (!is_moving) this.moving_pixels = MOVING_PIXELS;
    else if (this.late_ms > LATE_MS) this.moving_pixels = LATE_PIXELS;
    const share = is_moving ? Math.min(1, Math.sqrt(this.moving_pixels / Math.max(1, pixels))) : 1;
    if (share === this.pixel_share) return;
    this.pixel_share = share;
    this.fit();
  }

  /** Draw an object alone before a background, from the usual side; return the picture as a data URL. */
  portrait(object: Object3D, background: Object3D, width_px: number, height_px: number): string {
    const drawn = [object, background];
    const hidden = this.scene.children.filter((child) => child.visible && !drawn.includes(child) && !("isLight" in child));
    for (const child of hidden) child.visible = false;
    const camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, width_px / height_px, NEAR_M, FAR_M);
    camera.up.set(0, 0, 1);
    camera.lookAt(placeCamera(camera, new Box3().setFromObject(object), FIELD_OF_VIEW_RAD, camera.aspect));
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width_px, height_px, false);
    this.renderer.render(this.scene, camera);
    const picture = this.canvas.toDataURL();
    for (const child of hidden) child.visible = true;
    this.fit();
    return picture;
  }

  private look(box: Box3): void {
    const { width, height } = this.free.getBoundingClientRect();
    const tan_free = (Math.tan(FIELD_OF_VIEW_RAD / 2) * height) / Math.max(1, this.canvas.clientHeight);
    this.orbit.target.copy(placeCamera(this.camera, box, 2 * Math.atan(tan_free), width / Math.max(1, height)));
    this.orbit.update();
  }

  private fit(): void {
    const width = Math.max(1, this.canvas.clientWidth);
    const height = Math.max(1, this.canvas.clientHeight);
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO) * this.pixel_share);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // The camera looks at the middle of the free part.
    const canvas = this.canvas.getBoundingClientRect();
    const free = this.free.getBoundingClientRect();
    const right_px = free.left + free.width / 2 - canvas.left - width / 2;
    const down_px = free.top + free.height / 2 - canvas.top - height / 2;
    this.camera.setViewOffset(width, height, -right_px, -down_px, width, height);
  }
}

/** Put a camera at the usual side of a box, which then fills its picture; return the box's middle. */
export function placeCamera(camera: PerspectiveCamera, box: Box3, field_of_view_rad: number, aspect: number): Vector3 {
  const center = box.getCenter(new Vector3());
  const right = new Vector3(-VIEW_DIRECTION.y, VIEW_DIRECTION.x, 0).normalize();
  const up = VIEW_DIRECTION.clone().cross(right);
  const tan_up = Math.tan(field_of_view_rad / 2) * FILLED;
  const { min, max } = box;
  const corners = [min.x, max.x].flatMap((x) => [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) => new Vector3(x, y, z).sub(center))));
  const distances_m = corners.map((corner) => {
    return Math.max(Math.abs(corner.dot(right)) / (tan_up * aspect), Math.abs(corner.dot(up)) / tan_up) + corner.dot(VIEW_DIRECTION);
  });
  camera.position.copy(center).addScaledVector(VIEW_DIRECTION, Math.max(...distances_m));
  return center;
}
