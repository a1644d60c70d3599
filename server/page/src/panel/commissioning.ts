import { asksAnew, droopText, procedureTitle, rangeBar, rangeText, type BarPart } from "../logic/commissioning";
import { openPanel } from "../logic/layout";
import { denialReason } from "../logic/permissions";
import type { Commissioning, State, SweptJoint } from "../state/state";
import { selectGoal, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, capitalized, el, keyedList, section, setText, showList, type ListItem } from "./dom";

/** Time for which new answers cannot be pressed [ms]: the second click of a double click must not answer what comes next. */
const ARMING_MS = 400;

/** Create the bar that tells of a procedure in progress, with its cancel; it belongs where nothing scrolls it away. */
export function procedureBar(context: PanelContext): HTMLElement {
  const { store, commissioning: commands } = context;
  const text = el("span", { testid: "procedure", role: "status" });
  const progress = el("progress", { testid: "procedure-progress", label: t("commissioning.progress") });
  const cancel = button(t("commissioning.cancel"), "procedure-cancel", () => void commands.cancel(), t("commissioning.cancel.hint"));
  const box = el("div", { class: "procedure" }, text, progress, permissionFieldset(context, "configure", cancel));
  store.subscribe(
    (state) => state.commissioning,
    (commissioning) => {
      box.hidden = !isInProgress(commissioning);
      if (commissioning === null) return;
      setText(text, t("commissioning.in_progress", { procedure: procedureTitle(commissioning.procedure) }));
      progress.value = commissioning.progress;
    },
  );
  return box;
}

/** Create the section that calibrates and verifies the arm; hidden where the server offers neither. */
export function commissioningSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const reason = el("p", { class: "hint", testid: "commissioning-reason" });
  const idle = idlePart(context);
  const active = activePart(context);
  const findings = el("ul", { class: "findings", testid: "findings", label: t("commissioning.findings") });
  const result = el("p", { class: "result", testid: "procedure-result", role: "status" });
  const joints = jointList(store);
  const box = section("commissioning", t("commissioning.title"), false, reason, idle, active, joints.list, findings, result);
  let before: Commissioning | null = null;
  const show = (state: State): void => {
    const { commissioning } = state;
    box.hidden = commissioning === null;
    const denied = denialReason("commission", state);
    setText(reason, denied);
    reason.hidden = denied === "";
    if (commissioning === null) return;
    const is_in_progress = isInProgress(commissioning);
    if (is_in_progress && !isInProgress(before)) {
      box.open = true;
      store.set({ layout: openPanel(store.state.layout, "arm") });
      // The ghost of a goal would stand beside the model that is to be compared with the arm.
      if (state.selection.kind !== "none") selectGoal(store, "none", null);
    }
    idle.hidden = is_in_progress;
    active.hidden = !is_in_progress;
    showList(findings, commissioning.findings);
    setText(result, is_in_progress ? "" : capitalized(commissioning.result));
    joints.show(commissioning.joints);
    before = commissioning;
  };
  store.watch(["commissioning", "identity", "control", "joint_in_hand"], show);
  return box;
}

function isInProgress(commissioning: Commissioning | null): boolean {
  return commissioning !== null && commissioning.procedure !== "";
}

function idlePart(context: PanelContext): HTMLElement {
  const { commissioning: commands, store } = context;
  const placeholder = t("commissioning.name.default");
  const attributes = { autocomplete: "off", spellcheck: "false", maxlength: "100", placeholder };
  const name = el("input", { type: "text", testid: "calibration-name", label: t("commissioning.name"), attributes });
  const begin = (procedure: "calibrate" | "verify") => (): void => {
    for (const each of buttons) each.disabled = true;
    void commands.begin(procedure, name.value.trim()).then(() => enable());
  };
  const buttons = [
    button(t("commissioning.calibrate"), "calibrate", begin("calibrate"), t("commissioning.calibrate.hint")),
    button(t("commissioning.verify"), "verify", begin("verify"), t("commissioning.verify.hint")),
  ];
  const enable = (): void => {
    for (const each of buttons) each.disabled = !store.state.link.connected;
  };
  store.subscribe((state) => state.link.connected, enable);
  const line = el("label", { class: "line" }, `${t("commissioning.calibration")} `, name);
  const hint = el("p", { class: "hint", text: t("commissioning.hint") });
  return permissionFieldset(context, "commission", hint, line, el("div", { class: "buttons" }, ...buttons));
}

function activePart(context: PanelContext): HTMLElement {
  const { store, commissioning: commands } = context;
  // Focusable, so that the keyboard is led from an answer to what is asked next.
  const attributes = { tabindex: "-1", "aria-live": "assertive" };
  const instruction = el("p", { class: "instruction", testid: "instruction", attributes });
  const answers = el("div", { class: "buttons", testid: "answers", role: "group", label: t("commissioning.answers") });
  const box = el("div", { class: "step" }, instruction, permissionFieldset(context, "commission", answers));
  let is_armed = false;
  let timer: ReturnType<typeof setTimeout> | undefined;
  let before: Commissioning | null = null;
  const enable = (): void => {
    const is_open = is_armed && store.state.link.connected;
    for (const each of answers.querySelectorAll("button")) each.disabled = !is_open;
  };
  const press = (step: string, answer: string) => (): void => {
    is_armed = false;
    // Before the buttons are disabled, which would send the focus to the beginning of the page.
    instruction.focus();
    enable();
    const asked = before;
    void commands.answer(step, answer).then(() => {
      // A new step has answers of its own by now.
      if (asksAnew(asked, before)) return;
      is_armed = true;
      enable();
    });
  };
  const ask = ({ step, answers: texts }: Commissioning): void => {
    const had_focus = answers.contains(document.activeElement);
    const buttons = texts.map((answer, index) => button(capitalized(answer), `answer-${index}`, press(step, answer)));
    answers.replaceChildren(...buttons);
    if (had_focus) instruction.focus();
    // Not for those who only look on. The frame after this has the section open.
    if (!denialReason("commission", store.state)) requestAnimationFrame(() => box.scrollIntoView({ block: "nearest" }));
    is_armed = false;
    clearTimeout(timer);
    timer = setTimeout(() => {
      is_armed = true;
      enable();
    }, ARMING_MS);
    enable();
  };
  store.subscribe(
    (state) => state.commissioning,
    (commissioning) => {
      const is_new = asksAnew(before, commissioning);
      before = commissioning;
      if (commissioning === null) return;
      setText(instruction, commissioning.instruction);
      if (is_new) ask(commissioning);
    },
  );
  store.subscribe((state) => state.link.connected, enable);
  return box;
}

function jointList(store: PageStore): { list: HTMLElement; show: (joints: readonly SweptJoint[]) => void } {
  const list = el("ul", { class: "sweep", testid: "swept-joints", label: t("commissioning.joints") });
  const showBars = keyedList<SweptJoint>(list, ({ joint }) => joint, ({ joint }) => jointBar(store, joint));
  const show = (joints: readonly SweptJoint[]): void => {
    list.hidden = joints.length === 0;
    showBars(joints);
  };
  show([]);
  return { list, show };
}

function jointBar(store: PageStore, name: string): ListItem<SweptJoint> {
  const tick = el("span", { class: "tick", testid: `swept-${name}-done` });
  const text = el("span", { class: "measured", testid: `swept-${name}-text` });
  const [expected, swept, present] = [el("i", { class: "expected" }), el("i", { class: "swept" }), el("i", { class: "present" })];
  const bar = el("div", { class: "bar", role: "meter", label: t("commissioning.range", { joint: name }) }, swept, expected, present);
  const ticks = el("span", { class: "limits", testid: `swept-${name}-ticks`, title: t("commissioning.ticks") });
  const droop = el("span", { class: "measured", testid: `swept-${name}-droop` });
  const note = el("small", { class: "hint", testid: `swept-${name}-note` });
  const head = el("div", { class: "row-head" }, el("b", { text: name }), text, droop, tick);
  const element = el("li", { testid: `swept-${name}` }, head, bar, ticks, note);
  const show = (joint: SweptJoint): void => {
    const shown = rangeBar(joint);
    element.dataset["inHand"] = String(store.state.joint_in_hand?.joint === name);
    setText(tick, joint.done ? `✓ ${t("commissioning.done")}` : "");
    setText(text, rangeText(joint));
    setText(droop, droopText(joint.droop_rad));
    setText(ticks, `${joint.lowest} … ${joint.present} … ${joint.highest}`);
    setText(note, joint.note);
    // A verification moves joints without measuring their ranges.
    const has_range = joint.expected_width > 0 || joint.highest > joint.lowest;
    for (const part of [bar, text, ticks]) part.hidden = !has_range;
    place(swept, shown.swept);
    place(present, { begin: shown.present, width: 0 });
    expected.hidden = shown.expected === null;
    if (shown.expected) place(expected, shown.expected);
    bar.setAttribute("aria-valuemin", "0");
    bar.setAttribute("aria-valuemax", String(Math.max(joint.expected_width, joint.highest - joint.lowest)));
    bar.setAttribute("aria-valuenow", String(joint.highest - joint.lowest));
    bar.setAttribute("aria-valuetext", joint.done ? `${rangeText(joint)}, ${t("commissioning.done")}` : rangeText(joint));
  };
  return { element, show };
}

function place(element: HTMLElement, { begin, width }: BarPart): void {
  element.style.left = `${100 * begin}%`;
  element.style.width = `${100 * width}%`;
}
