import type { ArmCommands } from "../link/commands";
import { groupPoses } from "../logic/joints";
import { duration_s } from "../logic/trajectory";
import type { ActiveGoal, State } from "../state/state";
import { selectGoal, type PageStore } from "../state/store";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, section, setText } from "./dom";

/** Create the section that plans and executes motions, with named poses and speeds. */
export function motionSection(context: PanelContext): HTMLElement {
  const { store, moveGroup } = context;
  const plan = button("Plan", "plan", () => void moveGroup.plan(), "Plan and show the motion; nothing moves");
  const move = button("Move", "move", () => void moveGroup.execute(), "Carry out the motion that is shown");
  const at_once = "Plan the motion and carry it out at once";
  const both = button("Plan and move", "plan-and-move", () => void moveGroup.planAndExecute(), at_once);
  both.classList.add("primary");
  const show = ({ link, goal, plan: { trajectory }, selection }: State): void => {
    plan.disabled = both.disabled = !link.connected || selection.kind === "none";
    move.disabled = !link.connected || trajectory === null || goal.state === "executing";
  };
  for (const part of ["link", "goal", "plan", "selection"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const plan_only = permissionFieldset(context, "work", plan);
  const buttons = el("div", { class: "buttons" }, plan_only, permissionFieldset(context, "drive", move, both));
  return section("goals", "Motion", true, namedPoses(context), buttons, speedControls(context), torqueButtons(context));
}

function namedPoses(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const list = el("div", { class: "chips", testid: "named", role: "group", label: "named poses" });
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
    list.replaceChildren(
      ...poses.map(([name, { saved }]) => {
        const chip = button(name, `named-${name}`, () => choose(name), `Choose the pose “${name}”; nothing moves`);
        if (!saved) return chip;
        const forget = button("×", `delete-${name}`, () => void commands.deletePose(name), `Forget “${name}”`);
        return el("span", { class: "chip-pair" }, chip, permissionFieldset(context, "configure", forget));
      }),
    );
  };
  for (const part of ["named", "limits", "urdf", "srdf", "group"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
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
  const attributes = { placeholder: "name", maxlength: "64", autocomplete: "off" };
  const name = el("input", { type: "text", testid: "save-name", label: "name for the present pose", attributes });
  const save = async (): Promise<void> => {
    const typed = name.value.trim();
    if (typed === "") return name.focus();
    if (await commands.savePose(typed)) name.value = "";
  };
  const press = button("Save present pose", "save", () => void save());
  name.addEventListener("keydown", (event) => event.key === "Enter" && void save());
  return el("div", { class: "line" }, name, press);
}

/** Least fraction of the joints' speed limits; below it a motion takes minutes. */
const MIN_SPEED = 0.01;

/** Create the sliders for the speed of new motions and of the present one, and the buttons along its path. */
function speedControls(context: PanelContext): HTMLElement {
  const pace = permissionFieldset(context, "drive", executionPace(context));
  return el("div", { class: "rows" }, planningSpeed(context), pace, pathControls(context));
}

function fractionSlider(testid: string, label: string, least: number): HTMLInputElement {
  const attributes = { min: String(least), max: "1", step: "0.01" };
  return el("input", { type: "range", testid, label, attributes });
}

function planningSpeed({ store }: PanelContext): HTMLElement {
  const input = fractionSlider("speed", "speed of new motions", MIN_SPEED);
  const text = el("output", { testid: "speed-text" });
  input.addEventListener("input", () => store.patch("settings", { speed: Number(input.value) }));
  store.subscribe(
    (state) => state.settings.speed,
    (speed) => {
      input.value = String(speed);
      setText(text, `${Math.round(speed * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: "Speed of new motions" }), input, text);
}

function executionPace({ store, commands }: PanelContext): HTMLElement {
  const input = fractionSlider("pace", "pace of the present motion", 0);
  const text = el("output", { testid: "pace-text" });
  input.addEventListener("input", () => commands.setSpeedFactor(Number(input.value)));
  store.subscribe(
    (state) => state.arm.speed_factor,
    (factor) => {
      if (!input.matches(":active")) input.value = String(factor);
      setText(text, `${Math.round(factor * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: "Pace, also while it moves" }), input, text);
}

function pathControls(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const trigger = (service: string) => (): void => void commands.trigger(service);
  const pause = button("Pause", "pause", trigger("/arm/pause"), "Come to rest on the path and wait there");
  const resume = button("Resume", "resume", trigger("/arm/resume"), "Go on forward");
  const back = button("Step back", "step-back", trigger("/arm/step_back"), "Go back along the path");
  const pausing = permissionFieldset(context, "work", pause);
  const box = el("div", { class: "buttons" }, pausing, permissionFieldset(context, "drive", resume, back));
  const show = (): void => {
    const { arm, goal } = store.state;
    box.hidden = arm.mode !== "moving" && goal.state !== "executing";
    pause.disabled = arm.course === "paused";
    resume.disabled = arm.course === "forward";
  };
  store.subscribe((state) => state.arm, show);
  store.subscribe((state) => state.goal, show);
  return box;
}

/** Create the buttons for the torque and for faults. */
function torqueButtons(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const trigger = (service: string) => (): void => void commands.trigger(service);
  const relax = button("Relax", "relax", trigger("/arm/relax"), "Lower the torque slowly: the arm sinks");
  const hold = button("Hold", "hold", trigger("/arm/enable"), "Hold where the arm is");
  const reset = button("Reset fault", "reset-fault", trigger("/arm/reset_fault"), "Clear a fault whose cause is gone");
  store.subscribe(
    (state) => state.arm,
    ({ mode }) => {
      relax.disabled = mode === "relaxed" || mode === "disconnected";
      hold.disabled = mode !== "relaxed";
      reset.disabled = mode !== "fault";
    },
  );
  return el("div", { class: "buttons" }, permissionFieldset(context, "drive", relax, hold, reset));
}

/** Create the list of active goals, of all clients. */
export function activeGoalsSection({ store, stopCommand, commands }: PanelContext): HTMLElement {
  const list = el("ol", { class: "things", testid: "waiting" });
  const all = button("Cancel all", "cancel-all", () => void stopCommand.stop(), "Stop, and end all goals");
  const box = section("waiting", "Goals in hand and waiting", false, list, all);
  store.subscribe(
    (state) => state.active_goals,
    (goals) => {
      list.replaceChildren(...goals.map((goal) => goalItem(goal, () => commands.cancelGoal(goal.id))));
      all.disabled = goals.length === 0;
    },
  );
  return box;
}

function goalItem({ id, name, state }: ActiveGoal, cancel: () => void): HTMLElement {
  const text = el("span", { text: `${name} #${id}: ${state}` });
  return el("li", { testid: `waiting-${id}` }, text, button("Cancel", `cancel-${id}`, cancel));
}

/** Create the slider that shows the ghost at any time of the plan, and its replay button. */
export function planScrubber({ store }: PanelContext): HTMLElement {
  const attributes = { min: "0", max: "0", step: "0.01" };
  const slider = el("input", { type: "range", testid: "scrubber", label: "time on the planned motion", attributes });
  const text = el("output", { testid: "scrubber-text" });
  const replay = new PlanReplay(store, (playing) => setText(play, playing ? "❚❚ Halt" : "▶ Replay"));
  const play = button("▶ Replay", "replay", () => replay.toggle());
  slider.addEventListener("input", () => {
    replay.end();
    store.patch("plan", { scrub_s: Number(slider.value) });
  });
  const box = el("div", { class: "scrubber" }, play, slider, text);
  store.subscribe(
    (state) => state.plan,
    ({ trajectory, scrub_s }) => {
      box.hidden = trajectory === null;
      if (!trajectory) return;
      const end_s = duration_s(trajectory);
      slider.max = String(end_s);
      slider.value = String(scrub_s ?? end_s);
      setText(text, `${(scrub_s ?? end_s).toFixed(2)} of ${end_s.toFixed(2)} s`);
    },
  );
  return box;
}

/** Replay of the plan by the ghost, in real time. */
class PlanReplay {
  private began_ms: number | null = null;

  constructor(
    private readonly store: PageStore,
    private readonly onChange: (playing: boolean) => void,
  ) {}

  toggle(): void {
    if (this.began_ms !== null) return this.end();
    this.began_ms = performance.now();
    this.onChange(true);
    this.step();
  }

  end(): void {
    this.began_ms = null;
    this.onChange(false);
  }

  private step(): void {
    const { trajectory } = this.store.state.plan;
    if (this.began_ms === null) return;
    if (!trajectory) return this.end();
    const now_s = (performance.now() - this.began_ms) / 1000;
    const end_s = duration_s(trajectory);
    this.store.patch("plan", { scrub_s: Math.min(now_s, end_s) });
    if (now_s >= end_s) this.end();
    else requestAnimationFrame(() => this.step());
  }
}
