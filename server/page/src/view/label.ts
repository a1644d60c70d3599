import type { Camera, Vector3 } from "three";

// Beside the arrows, not on them.
const ASIDE_PX = 16;
const ABOVE_PX = 24;

/** A short text beside a point of the scene. */
export class Label {
  private readonly element = document.createElement("div");
  private at: Vector3 | null = null;

  /**
   * @param canvas - the text is put over it.
   * @param camera - what the scene is seen by.
   */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Camera,
  ) {
    this.element.className = "view-label";
    this.element.dataset["testid"] = "target-distance";
    this.element.setAttribute("role", "status");
    this.element.hidden = true;
    canvas.parentElement?.append(this.element);
  }

  /** Shows a text at a point; an empty text hides it. */
  show(text: string, at: Vector3): void {
    this.element.hidden = text === "";
    if (this.element.textContent !== text) this.element.textContent = text;
    this.at = text === "" ? null : at.clone();
    this.place();
  }

  /** Brings the text to where its point is seen now. */
  place(): void {
    if (this.at === null) return;
    const seen = this.at.clone().project(this.camera);
    const x_px = ((seen.x + 1) / 2) * this.canvas.clientWidth;
    const y_px = ((1 - seen.y) / 2) * this.canvas.clientHeight;
    // Beside a point outside of the picture it stays at the edge: the panel is not written over.
    const x_inside_px = clamp(x_px + ASIDE_PX, this.canvas.clientWidth - this.element.offsetWidth);
    const y_inside_px = clamp(y_px - ABOVE_PX, this.canvas.clientHeight - this.element.offsetHeight);
    this.element.style.transform = `translate(${Math.round(x_inside_px)}px, ${Math.round(y_inside_px)}px)`;
  }
}

function clamp(value: number, upper: number): number {
  return Math.max(0, Math.min(value, upper));
}
