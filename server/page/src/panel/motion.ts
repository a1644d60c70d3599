import { DESCRIPTION, groupPoses } from "../logic/joints";
import type { State } from "../state/state";
import { selectGoal } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, deleteButton, el, nameForm, section, setText } from "./dom";
import { nextStep } from "./transport";

/** Create the section that chooses where to go and how fast; the button at the picture plans and starts the motion. */
export function motionSection(context: PanelContext): HTMLElement {
  const { store, moveGroup } = context;
  const both = button(t("move.both"), "plan-and-move", () => void moveGroup.planAndExecute());
  store.watch(["link", "goal", "plan", "selection"], (state) => {
    both.disabled = !state.link.connected || state.selection.kind === "none";
    both.title = both.disabled ? nextStep(state) : t("move.both.title");
  });
  const buttons = el("div", { class: "buttons" }, permissionFieldset(context, "drive", both));
  return section("goals", t("move.title"), true, namedPoses(context), buttons, speedControls(context), relaxButton(context));
}

function namedPoses(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const list = el("div", { class: "chips", testid: "named", role: "group", label: t("move.poses") });
  const choose = (name: string): void => {
    selectGoal(store, "named", groupPoses(store.state)[name]?.joints ?? null, name);
  };
  let shown = "";
  const show = (state: State): void => {
    const poses = Object.entries(groupPoses(state));
    // The rest of the state changes often, and would take the focus from a chip.
    const key = JSON.stringify(poses.map(([name, { saved }]) => [name, saved]));
    if (key === shown) return;
    shown = key;
    if (poses.length === 0) return list.replaceChildren(el("p", { class: "hint", text: t("move.no_poses") }));
    list.replaceChildren(
      ...poses.map(([name, { saved }]) => {
        const chip = button(name, `named-${name}`, () => choose(name), t("move.pose.title", { name }));
        if (!saved) return chip;
        const forget = deleteButton("×", `delete-${name}`, name, () => void commands.deletePose(name));
        return el("span", { class: "chip-pair" }, chip, permissionFieldset(context, "configure", forget));
      }),
    );
  };
  store.watch(DESCRIPTION, show);
  store.subscribe(
    (state) => state.selection,
    ({ name }) => {
      for (const chip of list.querySelectorAll("button")) {
        chip.setAttribute("aria-pressed", String(name !== undefined && chip.dataset["testid"] === `named-${name}`));
      }
    },
  );
  const texts = { testid: "save-name", label: t("move.save.label"), button: t("move.save"), button_testid: "save" };
  const form = nameForm(texts, (name) => name !== "" && commands.savePose(name));
  return el("div", {}, list, permissionFieldset(context, "configure", form));
}

/** Least fraction of the joints' speed limits; below it a motion takes minutes. */
const MIN_SPEED = 0.01;

/** Create the sliders for the speed of new motions, of the present one, and of every motion at most. */
function speedControls(context: PanelContext): HTMLElement {
  const pace = permissionFieldset(context, "drive", executionPace(context));
  return el("div", { class: "rows speeds" }, planningSpeed(context), pace, permissionFieldset(context, "work", speedLimit(context)));
}

function fractionSlider(testid: string, label: string, least: number): HTMLInputElement {
  const attributes = { min: String(least), max: "1", step: "0.01" };
  return el("input", { type: "range", testid, label, attributes });
}

function planningSpeed({ store }: PanelContext): HTMLElement {
  const input = fractionSlider("speed", t("move.speed"), MIN_SPEED);
  const text = el("output", { testid: "speed-text" });
  input.addEventListener("input", () => store.patch("settings", { speed: Number(input.value) }));
  store.subscribe(
    (state) => state.settings.speed,
    (speed) => {
      input.value = String(speed);
      setText(text, `${Math.round(speed * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: t("move.speed") }), input, text);
}

function executionPace({ store, commands }: PanelContext): HTMLElement {
  const input = fractionSlider("pace", t("move.pace"), 0);
  const text = el("output", { testid: "pace-text" });
  input.addEventListener("input", () => commands.setSpeedFactor(Number(input.value)));
  store.subscribe(
    (state) => state.arm.speed_factor,
    (factor) => {
      if (!input.matches(":active")) input.value = String(factor);
      setText(text, `${Math.round(factor * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: t("move.pace") }), input, text);
}

function speedLimit({ store, commands }: PanelContext): HTMLElement {
  const input = fractionSlider("speed-limit", t("move.limit"), MIN_SPEED);
  const text = el("output", { testid: "speed-limit-text" });
  const show = (limit: number): void => {
    input.value = String(limit);
    setText(text, `${Math.round(limit * 100)} %`);
  };
  // At the release of the slider: each value on the way would be a line of the server's log.
  input.addEventListener("change", async () => {
    if (!(await commands.setSpeedLimit(Number(input.value)))) show(store.state.speed_limit);
  });
  input.addEventListener("input", () => setText(text, `${Math.round(Number(input.value) * 100)} %`));
  store.subscribe(
    (state) => state.speed_limit,
    (limit) => {
      if (!input.matches(":active")) show(limit);
    },
  );
  return el("label", { class: "line" }, el("span", { text: t("move.limit") }), input, text);
}

/** Create the button that lowers the torque; the bar offers to hold again. */
function relaxButton(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const relax = button(t("move.relax"), "relax", () => void commands.trigger("/arm/relax"), t("move.relax.title"));
  store.subscribe(
    (state) => state.arm,
    ({ mode }) => {
      relax.disabled = ["", "relaxed", "disconnected"].includes(mode);
    },
  );
  return el("div", { class: "buttons" }, permissionFieldset(context, "drive", relax));
}
