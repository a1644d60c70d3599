import type { TeachingState } from "../state/state";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, deleteButton, el, labelled, nameForm, numberField, section, setText } from "./dom";

/** Fastest replay, as a multiple of the speed in which the motion was shown; as the server's. */
const MAX_SPEED = 2;

/** Create the section of motions that a hand shows: recording, replaying and editing them. */
export function teachingSection(context: PanelContext): HTMLElement {
  const { store, teaching } = context;
  const told = el("p", { role: "status", testid: "teach-told" });
  const list = el("ul", { class: "things", testid: "taught-motions" });
  const empty = el("p", { class: "hint", text: t("teaching.empty") });
  const stop = button(t("teaching.stop"), "stop-replay", () => teaching.stop());
  const { speed, reverse, box } = replayChoices();
  const shown = section("teaching", t("teaching.title"), false, recordForm(context), box, empty, list, stop, told);
  store.subscribe(
    (state) => state.teaching,
    (state, { teaching: { motions, edited, replaying, recording } }) => {
      shown.hidden = motions === null && recording === null;
      empty.hidden = motions !== null && motions.length > 0;
      box.hidden = !empty.hidden;
      stop.hidden = replaying === null;
      setText(told, state.told);
      const replay = (name: string): void => void teaching.replay(name, speed(), reverse.checked);
      const key = JSON.stringify([motions, edited, replaying]);
      if (list.dataset["shown"] === key) return;
      list.dataset["shown"] = key;
      list.replaceChildren(...(motions ?? []).map((name) => motionItem(context, name, state, replay)));
    },
  );
  return shown;
}

function recordForm(context: PanelContext): HTMLElement {
  const { store, teaching } = context;
  const texts = { testid: "teach-name", label: t("teaching.name"), button: t("teaching.record"), button_testid: "teach-begin", title: t("teaching.record.title") };
  const form = nameForm(texts, (name) => teaching.begin(name));
  const end = button(t("teaching.end"), "teach-end", () => void teaching.end());
  const discard = button(t("teaching.discard"), "teach-discard", () => void teaching.discard());
  const time = el("p", { testid: "teach-recording" });
  const running = el("div", {}, time, el("div", { class: "buttons" }, end, discard));
  store.subscribe(
    (state) => state.teaching.recording,
    (recording) => {
      form.hidden = recording !== null;
      running.hidden = recording === null;
      if (recording) setText(time, t("teaching.recording", { name: recording.name, seconds: recording.duration_s.toFixed(1) }));
    },
  );
  return permissionFieldset(context, "work", form, running);
}

interface ReplayChoices {
  speed: () => number;
  reverse: HTMLInputElement;
  box: HTMLElement;
}

function replayChoices(): ReplayChoices {
  let chosen = 1;
  const percent = { name: t("teaching.speed"), lower: 1, upper: MAX_SPEED * 100, unit: " %", digits: 0 };
  const speed = numberField("replay-speed", t("teaching.speed"), () => percent, (value) => (chosen = value / 100));
  speed.show("100");
  const reverse = el("input", { type: "checkbox", testid: "replay-reverse" });
  const box = el("div", {}, labelled(`${t("teaching.speed")} (%)`, speed.input), speed.problem, el("label", { class: "line" }, reverse, ` ${t("teaching.reverse")}`));
  return { speed: () => chosen, reverse, box };
}

function motionItem(context: PanelContext, name: string, { edited, replaying }: TeachingState, replay: (name: string) => void): HTMLElement {
  const { teaching } = context;
  const play = button(t("teaching.replay"), `replay-${name}`, () => replay(name));
  play.disabled = replaying !== null;
  play.setAttribute("aria-label", `${t("teaching.replay")}: ${name}`);
  const open = edited?.name === name;
  const edit = button(t("teaching.edit"), `edit-motion-${name}`, () => void teaching.edit(open ? null : name));
  edit.setAttribute("aria-label", `${t("teaching.edit")}: ${name}`);
  edit.setAttribute("aria-pressed", String(open));
  const add = button(t("teaching.add"), `add-motion-${name}`, () => void teaching.addToSequence(name), t("teaching.add.title"));
  add.setAttribute("aria-label", `${t("teaching.add")}: ${name}`);
  const points = button(t("teaching.as_waypoints"), `waypoints-of-${name}`, () => void teaching.addAsWaypoints(name), t("teaching.as_waypoints.title"));
  points.setAttribute("aria-label", `${t("teaching.as_waypoints")}: ${name}`);
  const item = el("li", {}, el("b", { text: name }), permissionFieldset(context, "drive", play), add, points, permissionFieldset(context, "configure", edit));
  if (open) item.append(motionEditor(context, name, edited.duration_s));
  return item;
}

function motionEditor(context: PanelContext, name: string, duration_s: number): HTMLElement {
  const { teaching } = context;
  let [from_s, to_s] = [0, duration_s];
  const range = (field: "teaching.from" | "teaching.to") => () => ({ name: t(field), lower: 0, upper: duration_s, unit: " s", digits: 2 });
  const from = numberField("trim-from", t("teaching.from"), range("teaching.from"), (value) => (from_s = value));
  const to = numberField("trim-to", t("teaching.to"), range("teaching.to"), (value) => (to_s = value));
  from.show("0");
  to.show(duration_s.toFixed(2));
  const trim = button(t("teaching.trim"), "trim-motion", () => void teaching.trim(name, from_s, to_s));
  const new_name = el("input", { type: "text", testid: "new-motion-name", attributes: { autocomplete: "off", maxlength: "50", value: name } });
  const rename = button(t("teaching.rename"), "rename-motion", () => void teaching.rename(name, new_name.value.trim()));
  const remove = deleteButton(t("teaching.delete"), "delete-motion", name, () => void teaching.remove(name));
  const fields = el("div", { class: "buttons" }, labelled(`${t("teaching.from")} (s)`, from.input), labelled(`${t("teaching.to")} (s)`, to.input), trim);
  const names = el("div", { class: "buttons" }, labelled(t("teaching.new_name"), new_name), rename, remove);
  return el("div", { class: "object-editor", testid: "motion-editor" }, permissionFieldset(context, "configure", fields, names), from.problem, to.problem);
}
