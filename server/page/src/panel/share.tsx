import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { t } from "../texts/texts";
import { AccessCode } from "./access-code";
import { saveBlob } from "./files";
import { Button, Section, Tick } from "./ui";

const FILM_MS = 10_000;

const FRAMES_PER_S = 25;

/** Kind of the film, which not every browser records. */
const FILM_TYPE = "video/webm";

export function Share(): JSX.Element {
  return (
    <Section name="share" title={t("share.title")}>
      <p class="hint">{t("share.hint")}</p>
      <AccessCode name="share" role="view" text={t("share.show_code")} />
      {typeof MediaRecorder !== "undefined" && MediaRecorder.isTypeSupported(FILM_TYPE) && <FilmControls />}
    </Section>
  );
}

function FilmControls(): JSX.Element {
  const [film, setFilm] = useState<Film | null>(null);
  const [saving, setSaving] = useState(false);
  const save = async (): Promise<void> => {
    setSaving(true);
    const blob = await film?.save();
    if (blob) saveBlob(`armbridge-${new Date().toISOString().replace(/[:.]/g, "-")}.webm`, blob);
    setSaving(false);
  };
  const turn = (on: boolean): void => {
    film?.stop();
    // The canvas of the start may have been replaced by another one.
    const canvas = document.querySelector<HTMLCanvasElement>("#view");
    setFilm(on && canvas ? new Film(canvas) : null);
  };
  return (
    <div class="buttons">
      <Tick testid="film-on" checked={film !== null} take={turn} text={t("share.film.on")} />
      <Button testid="film-save" disabled={film === null || saving} press={() => void save()}>{t("share.film.save", { seconds: FILM_MS / 1000 })}</Button>
    </div>
  );
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
