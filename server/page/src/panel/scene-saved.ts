import { MAX_SCENE_FILE_BYTES } from "../logic/scene-file";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, deleteButton, el, keyedList, nameForm, section } from "./dom";
import { fileInput, saveFile } from "./files";

/** Create the section of saved scenes: by name on the server, and as files of the user. */
export function savedScenesSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("ul", { class: "things", testid: "saved-scenes" });
  const empty = el("p", { class: "hint" });
  const form = permissionFieldset(context, "configure", saveForm(context));
  const showItems = keyedList<string>(list, String, (name) => ({ element: savedItem(context, name), show: () => undefined }));
  store.subscribe(
    ({ editing }) => editing.saved,
    (saved) => {
      showItems(saved ?? []);
      empty.textContent = saved === null ? t("world.saved.none_here") : t("world.saved.empty");
      empty.hidden = saved !== null && saved.length > 0;
      form.hidden = saved === null;
    },
  );
  return section("saved-scenes", t("world.saved"), false, form, empty, list, fileForm(context));
}

function saveForm({ sceneEditor }: PanelContext): HTMLElement {
  const texts = { testid: "scene-name", label: t("world.saved.name"), button: t("world.saved.save"), button_testid: "save-scene" };
  return nameForm(texts, (name) => sceneEditor.scenes("save", name));
}

function savedItem(context: PanelContext, name: string): HTMLElement {
  const { sceneEditor } = context;
  const load = button(t("world.saved.load"), `load-scene-${name}`, () => void sceneEditor.scenes("load", name));
  const remove = deleteButton(t("world.saved.delete"), `delete-scene-${name}`, name, () => void sceneEditor.scenes("delete", name));
  load.setAttribute("aria-label", `${t("world.saved.load")}: ${name}`);
  const title = el("b", { text: name });
  return el("li", {}, title, permissionFieldset(context, "work", load), permissionFieldset(context, "configure", remove));
}

/** Create the buttons that write the scene to a file of the user, and read it from one. */
function fileForm(context: PanelContext): HTMLElement {
  const { sceneEditor } = context;
  const save = async (): Promise<void> => {
    const text = await sceneEditor.fileText();
    if (text !== null) saveFile("scene.json", "application/json", text);
  };
  const download = button(t("world.file.download"), "download-scene", () => void save());
  const upload = fileInput("scene-file", t("world.file.upload"), (file) => openFile(context, file));
  return el("div", {}, el("div", { class: "buttons" }, download), permissionFieldset(context, "work", upload));
}

/** Read a file; one that is too large is refused by its size, before a byte of it is read. */
async function openFile({ sceneEditor }: PanelContext, file: File): Promise<void> {
  const { name, size } = file;
  if (size > MAX_SCENE_FILE_BYTES) {
    const values = { name, size: Math.ceil(size / 1e6), limit: MAX_SCENE_FILE_BYTES / 1e6 };
    return sceneEditor.edit({ result: t("world.file.large", values) });
  }
  await sceneEditor.loadFile(await file.text(), name);
}
