import type { JSX } from "preact";
import { setWaypoints } from "../link/sequence";
import { armGripper } from "../logic/joints";
import { MAX_WAYPOINTS, readSequence, sequenceText, type Waypoint } from "../logic/sequence";
import { sequenceProgram, type ProgramLanguage } from "../logic/sequence-program";
import { loadPreference, storePreference } from "../state/preferences";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { saveFile } from "./files";
import { Button, DeleteButton, FileInput, NameForm, Section, usePage } from "./ui";

/** Keys of the browser's storage: the named sequences, and the one that is edited. */
const SAVED = "sequences";
const DRAFT = "sequence-draft";

/** Largest number of sequences that are kept: 50 of 50 waypoints are 0.5 MB, a tenth of what browsers store. */
const MAX_SAVED = 50;

/** Largest file that is read [bytes], many times that of the longest sequence. */
const MAX_FILE_BYTES = 1_000_000;

/** Load the sequences that the browser keeps, and keep the one that is edited from now on: a reload loses nothing. */
export function keepSequences(store: PageStore): void {
  store.patch("sequence", { saved: loadSaved() });
  setWaypoints(store, readSequence(loadPreference(DRAFT, "")) ?? []);
  store.subscribe((state) => state.sequence.waypoints, (waypoints) => void storePreference(DRAFT, sequenceText(waypoints)));
}

function loadSaved(): Record<string, readonly Waypoint[]> {
  try {
    const texts = JSON.parse(loadPreference(SAVED, "{}")) as Record<string, string>;
    const read = Object.entries(texts).map(([name, text]) => [name, readSequence(text)] as const);
    return Object.fromEntries(read.filter((pair): pair is [string, Waypoint[]] => pair[1] !== null));
  } catch {
    // A browser's storage may hold anything.
    return {};
  }
}

/** Keep the saved sequences; false where the browser stores nothing, and they last until the page is loaded again. */
function keep(store: PageStore, saved: Record<string, readonly Waypoint[]>): boolean {
  const texts = Object.entries(saved).map(([name, waypoints]) => [name, sequenceText(waypoints)] as const);
  store.patch("sequence", { saved });
  return storePreference(SAVED, JSON.stringify(Object.fromEntries(texts)));
}

export function SavedSequences(): JSX.Element {
  const { store } = usePage();
  const { saved, waypoints } = store.state.sequence;
  const names = Object.keys(saved).sort();
  const tell = (result: string): void => store.patch("sequence", { result });
  const save = (wanted: string): boolean => {
    if (waypoints.length === 0 || wanted === "") tell(t("sequence.saved.needs"));
    else if (!(wanted in saved) && names.length >= MAX_SAVED) tell(t("sequence.saved.full", { limit: MAX_SAVED }));
    else {
      tell(t(keep(store, { ...saved, [wanted]: waypoints }) ? "sequence.saved.done" : "sequence.saved.refused", { name: wanted }));
      return true;
    }
    return false;
  };
  /** Read a file; one that is too large is refused by its size, before a byte of it is read. */
  const open = async (file: File): Promise<void> => {
    const { name, size } = file;
    if (size > MAX_FILE_BYTES) return tell(t("sequence.file.large", { name, size: (size / 1e6).toFixed(1), limit: MAX_FILE_BYTES / 1e6 }));
    const read = readSequence(await file.text());
    if (read === null) return tell(t("sequence.file.none", { name, limit: MAX_WAYPOINTS }));
    setWaypoints(store, read);
  };
  const exportProgram = (language: ProgramLanguage): void => {
    const { file, text } = sequenceProgram(language, waypoints, store.state.link.url, armGripper(store.state)?.action ?? null);
    saveFile(file, "text/plain", text);
  };
  return (
    <Section name="saved-sequences" title={t("sequence.saved")}>
      <NameForm testid="sequence-name" label={t("sequence.saved.name")} button={t("sequence.saved.save")} button_testid="save-sequence" submit={save} />
      <p class="hint" hidden={names.length > 0}>{t("sequence.saved.empty")}</p>
      <ul class="things" data-testid="saved-sequences">
        {names.map((name) => (
          <li key={name}>
            <b>{name}</b>
            <Button testid={`load-sequence-${name}`} aria-label={`${t("sequence.saved.load")}: ${name}`} press={() => setWaypoints(store, saved[name] ?? [])}>{t("sequence.saved.load")}</Button>
            <DeleteButton text={t("sequence.saved.delete")} testid={`delete-sequence-${name}`} name={name} remove={() => void keep(store, Object.fromEntries(Object.entries(saved).filter(([other]) => other !== name)))} />
          </li>
        ))}
      </ul>
      <div class="buttons"><Button testid="download-sequence" press={() => saveFile("sequence.json", "application/json", sequenceText(waypoints))}>{t("sequence.file.download")}</Button></div>
      <FileInput testid="sequence-file" label={t("sequence.file.upload")} take={open} />
      <p class="hint">{t("sequence.export")}</p>
      <div class="buttons">
        <Button testid="export-python" disabled={waypoints.length === 0} press={() => exportProgram("python")}>{t("sequence.export.python")}</Button>
        <Button testid="export-javascript" disabled={waypoints.length === 0} press={() => exportProgram("javascript")}>{t("sequence.export.javascript")}</Button>
      </div>
    </Section>
  );
}
