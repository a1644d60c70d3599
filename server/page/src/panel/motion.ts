import type { ArmCommands } from "../link/commands";
import { DESCRIPTION, groupPoses } from "../logic/joints";
import { duration_s } from "../logic/trajectory";
import type { State } from "../state/state";
import { selectGoal, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, section, setText } from "./dom";
import { isAwaitingConfirmation } from "./status";

/** Return the next step to a motion, which is also why a button is disabled. */
export function nextStep({ link, goal, plan: { executable }, selection }: Pick<State, "link" | "goal" | "plan" | "selection">): string {
  if (!link.connected) return t("bar.offline.disabled");
  if (goal.state === "executing") return t("move.step.moving");
  if (isAwaitingConfirmation(goal)) return t("move.step.confirm");
  if (executable) return t("move.step.move");
  return t(selection.kind === "none" ? "move.step.choose" : "move.step.plan");
}

/** Create the section that plans and executes motions, with named poses and speeds. */
export function motionSection(context: PanelContext): HTMLElement {
  const { store, moveGroup } = context;
  const plan = button(t("move.plan"), "plan", () => void moveGroup.plan());
  const move = button(t("move.move"), "move", () => void moveGroup.execute());
  const both = button(t("move.both"), "plan-and-move", () => void moveGroup.planAndExecute());
  both.classList.add("primary");
  const hint = el("p", { class: "hint", id: "next-step", testid: "next-step", role: "status" });
  for (const each of [plan, move, both]) each.setAttribute("aria-describedby", hint.id);
  const show = (state: State): void => {
    const { link, goal, plan: { executable }, selection } = state;
    plan.disabled = both.disabled = !link.connected || selection.kind === "none";
    move.disabled = !link.connected || !executable || goal.state === "executing" || isAwaitingConfirmation(goal);
    setText(hint, nextStep(state));
    plan.title = plan.disabled ? nextStep(state) : t("move.plan.title");
    both.title = both.disabled ? nextStep(state) : t("move.both.title");
    move.title = move.disabled ? executable ? nextStep(state) : t("move.step.plan_first") : t("move.move.title");
  };
  store.watch(["link", "goal", "plan", "selection"], show);
  const plan_only = permissionFieldset(context, "work", plan);
  const buttons = el("div", { class: "buttons" }, plan_only, permissionFieldset(context, "drive", move, both));
  return section("goals", t("move.title"), true, namedPoses(context), hint, buttons, speedControls(context), relaxButton(context));
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
        const forget = button("×", `delete-${name}`, () => void commands.deletePose(name), t("move.forget", { name }));
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
  return el("div", {}, list, permissionFieldset(context, "configure", savePoseForm(commands)));
}

function savePoseForm(commands: ArmCommands): HTMLElement {
  const attributes = { placeholder: t("move.save.name"), maxlength: "64", autocomplete: "off" };
  const name = el("input", { type: "text", testid: "save-name", label: t("move.save.label"), attributes });
  const save = async (): Promise<void> => {
    const typed = name.value.trim();
    if (typed === "") return name.focus();
    if (await commands.savePose(typed)) name.value = "";
  };
  const press = button(t("move.save"), "save", () => void save());
  name.addEventListener("keydown", (event) => event.key === "Enter" && void save());
  return el("div", { class: "line" }, name, press);
}

/** Least fraction of the joints' speed limits; below it a motion takes minutes. */
const MIN_SPEED = 0.01;

/** Create the sliders for the speed of new motions, of the present one, and of every motion at most. */
function speedControls(context: PanelContext): HTMLElement {
  const pace = permissionFieldset(context, "drive", executionPace(context));
  return el("div", { class: "rows" }, planningSpeed(context), pace, permissionFieldset(context, "work", speedLimit(context)));
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

/** Create the slider that shows the ghost at any time of the plan, and its replay button. */
export function planScrubber({ store }: PanelContext): HTMLElement {
  const attributes = { min: "0", max: "0", step: "0.01" };
  const slider = el("input", { type: "range", testid: "scrubber", label: t("scrubber.time"), attributes });
  const text = el("output", { testid: "scrubber-text" });
  const replay = new PlanReplay(store);
  const play = button(t("scrubber.replay"), "replay", () => store.patch("plan", { replaying: !store.state.plan.replaying }));
  slider.addEventListener("input", () => store.patch("plan", { replaying: false, scrub_s: Number(slider.value) }));
  const box = el("div", { class: "scrubber" }, play, slider, text);
  store.subscribe(
    (state) => state.plan,
    ({ trajectory, scrub_s, replaying }) => {
      replay.update();
      box.hidden = trajectory === null;
      setText(play, t(replaying ? "scrubber.halt" : "scrubber.replay"));
      if (!trajectory) return;
      const end_s = duration_s(trajectory);
      slider.max = String(end_s);
      slider.value = String(scrub_s ?? end_s);
      setText(text, t("scrubber.of", { now: (scrub_s ?? end_s).toFixed(1), end: end_s.toFixed(1) }));
    },
  );
  return box;
}

/** Replay of the plan by the ghost, in real time, while the state of the plan says so. */
class PlanReplay {
  private began_ms: number | null = null;

  constructor(private readonly store: PageStore) {}

  /** Begin or end as the plan says. */
  update(): void {
    const { replaying } = this.store.state.plan;
    if (!replaying) this.began_ms = null;
    else if (this.began_ms === null) {
      this.began_ms = performance.now();
      requestAnimationFrame(() => this.step());
    }
  }

  private step(): void {
    const { trajectory } = this.store.state.plan;
    if (this.began_ms === null || !trajectory) return;
    const now_s = (performance.now() - this.began_ms) / 1000;
    const end_s = duration_s(trajectory);
    this.store.patch("plan", { scrub_s: Math.min(now_s, end_s), replaying: now_s < end_s });
    if (now_s < end_s) requestAnimationFrame(() => this.step());
  }
}
