import type { JSX } from "preact";
import { MAX_SCENE_FILE_BYTES } from "../link/planning-scene";
import { t } from "../texts/texts";
import { saveFile } from "./files";
import { Button, DeleteButton, FileInput, Gate, NameForm, Section, usePage } from "./ui";

export function SavedScenes(): JSX.Element {
  const { store, sceneEditor } = usePage();
  const { saved } = store.state.editing;
  const download = async (): Promise<void> => {
    const text = await sceneEditor.fileText();
    if (text !== null) saveFile("scene.json", "application/json", text);
  };
  /** Read a file; one that is too large is refused by its size, before a byte of it is read. */
  const open = async (file: File): Promise<void> => {
    const { name, size } = file;
    const values = { name, size: Math.ceil(size / 1e6), limit: MAX_SCENE_FILE_BYTES / 1e6 };
    if (size > MAX_SCENE_FILE_BYTES) sceneEditor.edit({ result: t("world.file.large", values) });
    else await sceneEditor.loadFile(await file.text(), name);
  };
  return (
    <Section name="saved-scenes" title={t("world.saved")} open={false}>
      <Gate to="configure" hidden={saved === null}>
        <NameForm testid="scene-name" label={t("world.saved.name")} button={t("world.saved.save")} button_testid="save-scene" submit={(name) => sceneEditor.scenes("save", name)} />
      </Gate>
      <p class="hint" hidden={saved !== null && saved.length > 0}>{t(saved === null ? "world.saved.none_here" : "world.saved.empty")}</p>
      <ul class="things" data-testid="saved-scenes">
        {(saved ?? []).map((name) => (
          <li key={name}>
            <b>{name}</b>
            <Gate to="work"><Button testid={`load-scene-${name}`} aria-label={`${t("world.saved.load")}: ${name}`} press={() => void sceneEditor.scenes("load", name)}>{t("world.saved.load")}</Button></Gate>
            <Gate to="configure"><DeleteButton text={t("world.saved.delete")} testid={`delete-scene-${name}`} name={name} remove={() => void sceneEditor.scenes("delete", name)} /></Gate>
          </li>
        ))}
      </ul>
      <div class="buttons"><Button testid="download-scene" press={() => void download()}>{t("world.file.download")}</Button></div>
      <Gate to="work"><FileInput testid="scene-file" label={t("world.file.upload")} take={open} /></Gate>
    </Section>
  );
}
