import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { button, el, section } from "./dom";
import { saveBlob } from "./files";
import { accessCode } from "./phone";

/** Length of the film of the picture's last seconds [ms]. */
const FILM_MS = 10_000;

const FRAMES_PER_S = 25;

/** Kind of the film, which not every browser records. */
const FILM_TYPE = "video/webm";

/** Create the section that shows the arm to others: a code for a page that may only look, and a film of the last seconds. */
export function shareSection(context: PanelContext): HTMLElement {
  const hint = el("p", { class: "hint", text: t("share.hint") });
  return section("share", t("share.title"), true, hint, accessCode(context, "share", "view", t("share.show_code")), filmControls());
}

/** Create the switch that keeps the last seconds, and the button that saves them. */
function filmControls(): HTMLElement {
  const on = el("input", { type: "checkbox", testid: "film-on" });
  const save = button(t("share.film.save", { seconds: FILM_MS / 1000 }), "film-save", () => void saveFilm());
  let film: Film | null = null;
  const saveFilm = async (): Promise<void> => {
    save.disabled = true;
    const blob = await film?.save();
    if (blob) saveBlob(`armbridge-${new Date().toISOString().replace(/[:.]/g, "-")}.webm`, blob);
    save.disabled = film === null;
  };
  save.disabled = true;
  on.addEventListener("change", () => {
    film?.stop();
    // The canvas of the start may have been replaced by another one.
    const canvas = document.querySelector<HTMLCanvasElement>("#view");
    film = on.checked && canvas ? new Film(canvas) : null;
    save.disabled = film === null;
  });
  const box = el("div", { class: "buttons" }, el("label", { class: "line" }, on, t("share.film.on")), save);
  box.hidden = typeof MediaRecorder === "undefined" || !MediaRecorder.isTypeSupported(FILM_TYPE);
  return box;
}

interface Take {
  recorder: MediaRecorder;
  parts: Blob[];
}

/** Film of a canvas: a take begins every ten seconds and the last two are kept, of which the older has the last seconds. */
class Film {
  private takes: Take[] = [];
  private readonly stream: MediaStream;
  private readonly timer: ReturnType<typeof setInterval>;

  constructor(canvas: HTMLCanvasElement) {
    this.stream = canvas.captureStream(FRAMES_PER_S);
    this.begin();
    this.timer = setInterval(() => this.begin(), FILM_MS);
  }

  /** End the older take and return it. */
  async save(): Promise<Blob | null> {
    const take = this.takes.shift();
    if (take === undefined) return null;
    if (this.takes.length === 0) this.begin();
    await new Promise((resolve) => {
      take.recorder.addEventListener("stop", resolve);
      take.recorder.stop();
    });
    return new Blob(take.parts, { type: FILM_TYPE });
  }

  /** End everything. */
  stop(): void {
    clearInterval(this.timer);
    for (const { recorder } of this.takes) recorder.stop();
    for (const track of this.stream.getTracks()) track.stop();
  }

  private begin(): void {
    const take: Take = { recorder: new MediaRecorder(this.stream, { mimeType: FILM_TYPE }), parts: [] };
    take.recorder.addEventListener("dataavailable", ({ data }) => take.parts.push(data));
    take.recorder.start();
    this.takes.push(take);
    if (this.takes.length > 2) this.takes.shift()?.recorder.stop();
  }
}
