import "./sequence.css";
import { setWaypoints } from "../link/sequence";
import { armGripper, armJoints, currentPositions, DESCRIPTION } from "../logic/joints";
import { planningGroup } from "../logic/robot-info";
import {
  edited,
  MAX_PAUSE_S,
  MAX_WAYPOINTS,
  MIN_SPEED,
  moved,
  newWaypoint,
  poseKey,
  readSequence,
  sequenceDuration_s,
  sequenceText,
  type LegCheck,
  type Waypoint,
} from "../logic/sequence";
import type { JointValues, State } from "../state/state";
import { selectGoal, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, deleteButton, el, keyedList, loadPreference, nameForm, numberField, option, section, setText, storePreference, type ListItem } from "./dom";
import { fileInput, saveFile } from "./files";
import { programButtons } from "./sequence-export";

/** Create the section of the sequence: its waypoints, and the buttons that add them and play it. */
export function sequenceSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const empty = el("p", { class: "hint", text: t("sequence.empty") });
  const list = el("ol", { class: "waypoints", testid: "waypoints", label: t("sequence.waypoints") });
  const editing = el("fieldset", { class: "editing" }, addButtons(store), empty, list);
  const showRows = keyedList<Waypoint>(list, ({ id }) => String(id), ({ id }) => waypointRow(store, id));
  const show = ({ sequence: { waypoints, playing } }: State): void => {
    showRows(waypoints);
    empty.hidden = waypoints.length > 0;
    editing.disabled = playing !== null;
  };
  store.watch(["sequence", "thumbnails", "settings", ...DESCRIPTION], show);
  return section("sequence", t("sequence.title"), true, editing, playControls(context));
}

function addButtons(store: PageStore): HTMLElement {
  const add = (joints_rad: JointValues | null): void => {
    const { sequence, settings } = store.state;
    if (joints_rad === null || sequence.waypoints.length >= MAX_WAYPOINTS) return;
    const group = planningGroup(store.state)?.name ?? "";
    setWaypoints(store, [...sequence.waypoints, newWaypoint(sequence.waypoints, group, joints_rad, settings.speed)]);
  };
  const here = button(t("sequence.add_here"), "add-here", () => add(presentJoints(store.state)));
  const goal = button(t("sequence.add_goal"), "add-goal", () => add(chosenJoints(store.state)), t("sequence.add_goal.title"));
  const show = (state: State): void => {
    const full = state.sequence.waypoints.length >= MAX_WAYPOINTS;
    here.disabled = full || presentJoints(state) === null;
    goal.disabled = full || chosenJoints(state) === null;
    here.title = full ? t("sequence.full", { limit: MAX_WAYPOINTS }) : "";
  };
  store.watch(["joints", "sequence", "selection", "target", ...DESCRIPTION], show);
  return el("div", { class: "buttons" }, here, goal);
}

/** Return the measured positions of the group's joints; null before the server has told them all. */
function presentJoints(state: State): JointValues | null {
  return ofGroup(state, currentPositions(state));
}

/** Return the joint values of the selected goal, which the ghost shows; null without one that can be reached. */
function chosenJoints(state: State): JointValues | null {
  const { selection, target } = state;
  if (selection.kind === "none" || (selection.kind === "target" && target.reachable !== true)) return null;
  const chosen = selection.kind === "target" ? target.joints_rad : selection.joints_rad;
  return chosen && ofGroup(state, { ...currentPositions(state), ...chosen });
}

function ofGroup(state: State, values: JointValues): JointValues | null {
  const names = armJoints(state);
  const pairs = names.flatMap((name) => (values[name] === undefined ? [] : [[name, values[name]] as const]));
  return names.length > 0 && pairs.length === names.length ? Object.fromEntries(pairs) : null;
}

/** Type of what is dragged, so that nothing else can be dropped. */
const DRAGGED = "application/x-waypoint";

function waypointRow(store: PageStore, id: number): ListItem<Waypoint> {
  const own = `waypoint-${id}`;
  const list = (): readonly Waypoint[] => store.state.sequence.waypoints;
  const index = (): number => list().findIndex((waypoint) => waypoint.id === id);
  const edit = (patch: Partial<Waypoint>): void => setWaypoints(store, edited(list(), id, patch));
  const reorder = (to: number): void => setWaypoints(store, moved(list(), id, to));

  const handle = el("span", { class: "handle", testid: `${own}-handle`, text: "⠿", title: t("sequence.drag"), attributes: { draggable: "true", "aria-hidden": "true" } });
  const name = el("input", { type: "text", testid: `${own}-name`, label: t("sequence.name"), attributes: { maxlength: "50", autocomplete: "off" } });
  name.addEventListener("change", () => edit({ name: name.value.trim() || String(id) }));
  const check = el("p", { class: "leg-check", testid: `${own}-check` });

  const way = select(`${own}-way`, t("sequence.way"), (value) => edit({ straight: value === "straight" }));
  const taught = option("taught", "");
  way.append(option("free", t("sequence.way.free")), option("straight", t("sequence.way.straight")), taught);
  const percent = { name: t("sequence.speed"), lower: MIN_SPEED * 100, upper: 100, unit: " %", digits: 0 };
  const speed = numberField(`${own}-speed`, t("sequence.speed"), () => percent, (value) => edit({ speed: value / 100 }));
  const seconds = { name: t("sequence.pause"), lower: 0, upper: MAX_PAUSE_S, unit: " s", digits: 1 };
  const pause = numberField(`${own}-pause`, t("sequence.pause"), () => seconds, (pause_s) => edit({ pause_s }));
  const gripper = select(`${own}-gripper`, t("sequence.gripper"), (value) => edit({ gripper: gripperPosition(store.state, value) }));
  const gripper_field = measure(t("sequence.gripper"), gripper);

  const up = iconButton("↑", `${own}-up`, t("sequence.up"), () => reorder(index() - 1));
  const down = iconButton("↓", `${own}-down`, t("sequence.down"), () => reorder(index() + 1));
  const picture = el("img", { class: "thumbnail", attributes: { alt: "", width: "84", height: "63" } });
  const ghost = button("", `${own}-show`, () => selectGoal(store, "joints", list()[index()]?.joints_rad ?? null), t("sequence.show.title"));
  ghost.append(picture);
  ghost.classList.add("waypoint-picture");
  const remove = iconButton("×", `${own}-remove`, t("sequence.remove"), () => setWaypoints(store, list().filter((waypoint) => waypoint.id !== id)));

  const fields = el("div", { class: "waypoint-fields" }, measure(t("sequence.way"), way), measure(`${t("sequence.speed")} (%)`, speed.input), gripper_field, measure(`${t("sequence.pause")} (s)`, pause.input));
  const tools = el("div", { class: "waypoint-tools" }, handle, up, down, remove);
  const head = el("div", { class: "waypoint-head" }, ghost, name, tools, check);
  const element = el("li", { testid: own }, head, fields, speed.problem, pause.problem);
  takeDrops(element, handle, id, (dragged) => setWaypoints(store, moved(list(), dragged, index())));

  const show = (waypoint: Waypoint, at: number): void => {
    const { state } = store;
    const answer = state.sequence.checks[at];
    if (document.activeElement !== name) name.value = waypoint.name;
    // A taught motion ends where it ends: it is replaced by removing its row.
    way.disabled = waypoint.motion !== null;
    taught.hidden = waypoint.motion === null;
    taught.textContent = t("sequence.way.taught", { name: waypoint.motion?.name ?? "" });
    way.value = waypoint.motion ? "taught" : waypoint.straight ? "straight" : "free";
    speed.show(String(Math.round(waypoint.speed * 100)));
    pause.show(String(waypoint.pause_s));
    gripper_field.hidden = armGripper(state) === null;
    showGripper(gripper, waypoint.gripper, state);
    const thumbnail = state.thumbnails[poseKey(waypoint.joints_rad)] ?? "";
    picture.hidden = thumbnail === "";
    if (thumbnail !== "" && picture.src !== thumbnail) picture.src = thumbnail;
    const { playing, waypoints } = state.sequence;
    element.dataset["verdict"] = answer?.verdict ?? "checking";
    if (playing?.index === at && playing.doing !== "check") element.setAttribute("aria-current", "step");
    else element.removeAttribute("aria-current");
    setText(check, checkText(answer));
    up.disabled = at === 0;
    down.disabled = at === waypoints.length - 1;
    for (const [control, word] of [[up, "sequence.up"], [down, "sequence.down"], [remove, "sequence.remove"], [ghost, "sequence.show"]] as const) {
      control.setAttribute("aria-label", `${t(word)}: ${waypoint.name}`);
    }
  };
  return { element, show };
}

/** Let waypoints be dropped on one, whose place they take. */
function takeDrops(box: HTMLElement, handle: HTMLElement, id: number, drop: (dragged: number) => void): void {
  const mark = (over: boolean): void => void box.classList.toggle("drop-here", over);
  handle.addEventListener("dragstart", (event) => {
    event.dataTransfer?.setData(DRAGGED, String(id));
    event.dataTransfer?.setDragImage(box, 0, 0);
  });
  box.addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes(DRAGGED)) return;
    event.preventDefault();
    mark(true);
  });
  box.addEventListener("dragleave", () => mark(false));
  box.addEventListener("drop", (event) => {
    event.preventDefault();
    mark(false);
    const dragged = Number(event.dataTransfer?.getData(DRAGGED));
    if (dragged !== id) drop(dragged);
  });
}

function checkText(check: LegCheck | undefined): string {
  if (check === undefined || check.verdict === "checking") return t("sequence.checking");
  if (check.verdict === "unknown") return t("sequence.unknown", { message: check.message });
  if (check.verdict === "refused") return t("sequence.not_possible", { message: check.message });
  const possible = t("sequence.possible", { seconds: check.duration_s.toFixed(1) });
  return check.message === "" ? possible : `${possible} (${check.message})`;
}

/** Return the position of a choice of the gripper; null leaves it as it is. */
function gripperPosition(state: State, choice: string): number | null {
  const gripper = armGripper(state);
  if (gripper === null || choice === "leave") return null;
  // Before the first joint state the gripper's position is not known.
  if (choice === "present") return currentPositions(state)[gripper.joints[0] ?? ""] ?? null;
  return { open: gripper.open, closed: gripper.closed }[choice] ?? Number(choice);
}

function showGripper(choice: HTMLSelectElement, position: number | null, state: State): void {
  const gripper = armGripper(state);
  const named = [
    ["leave", t("sequence.gripper.leave"), null],
    ["open", t("sequence.gripper.open"), gripper?.open],
    ["closed", t("sequence.gripper.closed"), gripper?.closed],
  ] as const;
  const known = named.find(([, , value]) => value === position);
  const others = known ? [] : [option(String(position), t("sequence.gripper.at", { position: (position ?? 0).toFixed(2) }))];
  const key = `${others[0]?.value}`;
  if (choice.options.length === 0 || choice.dataset["other"] !== key) {
    choice.dataset["other"] = key;
    const all = named.map(([value, text]) => option(value, text));
    choice.replaceChildren(...all, option("present", t("sequence.gripper.present")), ...others);
  }
  choice.value = known?.[0] ?? String(position);
}

/** Create the buttons that play and stop the sequence, with its progress. */
function playControls(context: PanelContext): HTMLElement {
  const { store, sequencePlayer } = context;
  const play = button(t("sequence.play"), "play-sequence", () => void sequencePlayer.play(), t("sequence.play.title"));
  const stop = button(t("sequence.stop"), "stop-sequence", () => sequencePlayer.stop());
  const progress = el("progress", { testid: "sequence-progress", label: t("sequence.progress") });
  const told = el("p", { role: "status", testid: "sequence-told" });
  const total = el("output", { testid: "sequence-total" });
  const loop = el("input", { type: "checkbox", testid: "sequence-loop" });
  loop.addEventListener("change", () => store.patch("sequence", { loop: loop.checked }));
  store.subscribe(
    (state) => state.sequence,
    ({ waypoints, playing, result, checks }) => {
      const duration_s = sequenceDuration_s(waypoints, checks);
      setText(total, duration_s === null || waypoints.length === 0 ? "" : t("sequence.total", { seconds: duration_s.toFixed(1) }));
      play.disabled = waypoints.length === 0 || playing !== null;
      stop.disabled = playing === null;
      progress.hidden = playing === null;
      progress.max = Math.max(1, waypoints.length);
      progress.value = playing?.index ?? 0;
      const name = waypoints[playing?.index ?? 0]?.name ?? "";
      const values = { number: (playing?.index ?? 0) + 1, count: waypoints.length, name };
      setText(told, playing ? t(`sequence.doing.${playing.doing}`, values) : result);
    },
  );
  const repeat = el("label", { class: "line" }, loop, t("sequence.loop"));
  return el("div", {}, el("div", { class: "buttons" }, permissionFieldset(context, "drive", play), stop, repeat, total), progress, told);
}

/** Keys of the browser's storage: the named sequences, and the one that is edited. */
const SAVED = "sequences";
const DRAFT = "sequence-draft";

/** Largest number of sequences that are kept: 50 of 50 waypoints are 0.5 MB, a tenth of what browsers store. */
const MAX_SAVED = 50;

/** Largest file that is read [bytes], many times that of the longest sequence. */
const MAX_FILE_BYTES = 1_000_000;

/** Create the section that keeps sequences by name, and as files and programs. */
export function savedSequencesSection({ store }: PanelContext): HTMLElement {
  store.patch("sequence", { saved: loadSaved() });
  setWaypoints(store, readSequence(loadPreference(DRAFT, "")) ?? []);
  // A reload loses nothing.
  store.subscribe((state) => state.sequence.waypoints, (waypoints) => void storePreference(DRAFT, sequenceText(waypoints)));
  const list = el("ul", { class: "things", testid: "saved-sequences" });
  const empty = el("p", { class: "hint", text: t("sequence.saved.empty") });
  const showItems = keyedList<string>(list, String, (name) => ({ element: savedItem(store, name), show: () => undefined }));
  store.subscribe(
    (state) => state.sequence.saved,
    (saved) => {
      showItems(Object.keys(saved).sort());
      empty.hidden = Object.keys(saved).length > 0;
    },
  );
  return section("saved-sequences", t("sequence.saved"), true, saveForm(store), empty, list, fileForm(store), programButtons(store));
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

function saveForm(store: PageStore): HTMLElement {
  const texts = { testid: "sequence-name", label: t("sequence.saved.name"), button: t("sequence.saved.save"), button_testid: "save-sequence" };
  return nameForm(texts, (wanted) => {
    const { saved, waypoints } = store.state.sequence;
    const names = Object.keys(saved);
    const full = !names.includes(wanted) && names.length >= MAX_SAVED;
    if (waypoints.length === 0 || wanted === "") tell(store, t("sequence.saved.needs"));
    else if (full) tell(store, t("sequence.saved.full", { limit: MAX_SAVED }));
    else {
      const is_kept = keep(store, { ...saved, [wanted]: waypoints });
      tell(store, t(is_kept ? "sequence.saved.done" : "sequence.saved.refused", { name: wanted }));
      return true;
    }
    return false;
  });
}

function savedItem(store: PageStore, name: string): HTMLElement {
  const load = button(t("sequence.saved.load"), `load-sequence-${name}`, () => setWaypoints(store, store.state.sequence.saved[name] ?? []));
  const remove = deleteButton(t("sequence.saved.delete"), `delete-sequence-${name}`, name, () => {
    const { [name]: _, ...others } = store.state.sequence.saved;
    keep(store, others);
  });
  load.setAttribute("aria-label", `${t("sequence.saved.load")}: ${name}`);
  return el("li", {}, el("b", { text: name }), load, remove);
}

/** Create the controls that write the sequence to a file of the user, and read it from one. */
function fileForm(store: PageStore): HTMLElement {
  const download = button(t("sequence.file.download"), "download-sequence", () => {
    saveFile("sequence.json", "application/json", sequenceText(store.state.sequence.waypoints));
  });
  const upload = fileInput("sequence-file", t("sequence.file.upload"), (file) => openFile(store, file));
  return el("div", {}, el("div", { class: "buttons" }, download), upload);
}

/** Read a file; one that is too large is refused by its size, before a byte of it is read. */
async function openFile(store: PageStore, file: File): Promise<void> {
  const { name, size } = file;
  if (size > MAX_FILE_BYTES) return tell(store, t("sequence.file.large", { name, size: (size / 1e6).toFixed(1), limit: MAX_FILE_BYTES / 1e6 }));
  const waypoints = readSequence(await file.text());
  if (waypoints === null) return tell(store, t("sequence.file.none", { name, limit: MAX_WAYPOINTS }));
  setWaypoints(store, waypoints);
}

function tell(store: PageStore, result: string): void {
  store.patch("sequence", { result });
}

function select(testid: string, label: string, take: (value: string) => void): HTMLSelectElement {
  const choice = el("select", { testid, label });
  choice.addEventListener("change", () => take(choice.value));
  return choice;
}

function measure(text: string, control: HTMLElement): HTMLElement {
  return el("label", { class: "measure" }, el("span", { text }), control);
}

function iconButton(sign: string, testid: string, label: string, press: () => void): HTMLButtonElement {
  const created = button(sign, testid, press, label);
  created.setAttribute("aria-label", label);
  return created;
}
