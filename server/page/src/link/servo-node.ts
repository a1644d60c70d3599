import { armJoints, armNamespace, isOneArm, openedBy } from "../logic/joints";
import { summed, type JogCommand } from "../logic/jog";
import { denialReason } from "../logic/permissions";
import { planningGroup } from "../logic/robot-info";
import type { State } from "../state/state";
import { onConnect, setNotice, type PageStore } from "../state/store";
import type { ArmCommands } from "./commands";
import type { Connection } from "./connection";
import { jointJog, readArmState, twistStamped } from "./messages";

/** Period of commands [ms]: three fit into the time after which a command expires. */
export const PERIOD_MS = 25;

/** Time after which the server lets a command of this page expire [s]; it brakes within 0.1 s with its own period of 0.02 s. */
export const COMMAND_TIMEOUT_S = 0.08;

/** Time between two goals of the gripper, which has no servo topic [ms]. */
const GRIPPER_PERIOD_MS = 200;

/** Time in which the gripper goes through its range at full speed [s]. */
const GRIPPER_RANGE_S = 1.5;

const COMMAND_TYPES = { joints: 0, tip: 1 } as const;

type ArmKind = keyof typeof COMMAND_TYPES;

/** Subscribe to status and parameters of the servo node of the planning group's arm, and to its speed limit. */
export function subscribeServoNode(connection: Pick<Connection, "subscribe">, store: PageStore): void {
  // By the namespace of each arm that was steered since the page was opened.
  const parameters = new Map<string, Partial<State["servo_node"]>>();
  // Without a namespace the limit is that of the arm, or the lowest of all arms.
  const limits = new Map([["", 1]]);
  const limit = (namespace: string, speed_limit: number): void => {
    limits.set(namespace, speed_limit);
    store.set({ speed_limit: limits.get(armNamespace(store.state)) ?? 1 });
  };
  store.subscribe((state) => state.arm.speed_limit, (speed_limit) => limit("", speed_limit));
  store.subscribe(armNamespace, (namespace) => {
    store.patch("servo_node", { code: 0, message: "", ...parameters.get(namespace) });
    limit(namespace, limits.get(namespace) ?? 1);
    if (parameters.has(namespace)) return;
    parameters.set(namespace, {});
    const isPresent = (): boolean => armNamespace(store.state) === namespace;
    connection.subscribe(`${namespace}/servo_node/status`, "moveit_msgs/msg/ServoStatus", ({ code, message }) => {
      if (isPresent()) store.patch("servo_node", { code, message });
    }, 100);
    connection.subscribe(`${namespace}/servo_node/parameters`, "std_msgs/msg/String", ({ data }) => {
      const told = JSON.parse(data) as Partial<State["servo_node"]>;
      parameters.set(namespace, told);
      if (isPresent()) store.patch("servo_node", told);
    });
    if (namespace !== "") connection.subscribe(`${namespace}/arm/state`, "diagnostic_msgs/msg/DiagnosticStatus", (status) => limit(namespace, readArmState(status).speed_limit));
  });
  onConnect(store, () => store.patch("servo_node", { code: 0, message: "" }));
}

/**
 * Sender of the commands of all inputs: while any is held, its command is repeated; the last release sends a halt.
 *
 * Tip and joints cannot be steered at once: the input that was pressed last decides, and the others of its kind add up.
 */
export class JogSender {
  frame: "base" | "tool" = "base";
  private readonly held = new Map<string, JogCommand>();
  /** Inputs that were released from here while they were held, and those pressed since: nothing moves before all are let go. */
  private readonly locked = new Set<string>();
  private readonly release_listeners = new Set<() => void>();
  private timer: ReturnType<typeof setInterval> | undefined;
  private arm_kind: ArmKind | null = null;
  /** What the topics begin with of the arm that is steered. */
  private namespace = "";
  /** Joints of the last command, which the halt names. */
  private jogged: string[] = [];
  private gripper: { position: number; sent_ms: number } | null = null;

  constructor(
    private readonly connection: Pick<Connection, "publish" | "call">,
    private readonly store: PageStore,
    private readonly gripper_commands: Pick<ArmCommands, "moveGripper" | "cancelGripper">,
  ) {
    // What was begun with one arm does not go on with another.
    store.subscribe(armNamespace, (namespace) => {
      this.releaseAll();
      this.namespace = namespace;
      this.jogged = [];
    });
    // Anyone's stop.
    store.subscribe((state) => state.arm.last_stop, () => this.releaseAll());
  }

  /** True while any input is held, or must still be let go. */
  get busy(): boolean {
    return this.held.size + this.locked.size > 0;
  }

  /** Call back whenever everything is released by other means than the inputs themselves. */
  onReleaseAll(listener: () => void): void {
    this.release_listeners.add(listener);
  }

  /** Hold an input, or change the command of a held one; a new one is sent at once. */
  hold(input: string, command: JogCommand): void {
    const is_new = !this.held.has(input);
    if (!this.isAllowed()) return this.releaseAll();
    if (this.locked.size > 0) return void this.locked.add(input);
    this.held.set(input, command);
    if (command.kind !== "gripper" && is_new) this.announcePress();
    if (command.kind !== "gripper" && (is_new || this.arm_kind === null)) this.selectKind(command.kind);
    if (is_new) this.send();
    this.timer ??= setInterval(() => this.send(), PERIOD_MS);
  }

  /** Release an input; with the last one of the arm, halt. */
  release(input: string): void {
    this.locked.delete(input);
    const released = this.held.get(input);
    if (!this.held.delete(input)) return;
    if (released?.kind === "gripper") {
      if (this.commandsOf("gripper").length === 0) this.gripper = null;
    } else if (this.arm_kind && this.commandsOf(this.arm_kind).length === 0) this.halt();
    if (this.held.size === 0) this.stopTimer();
  }

  /** Release every input and halt at once; nothing moves the arm before all of them are let go. */
  releaseAll(): void {
    for (const input of this.held.keys()) this.locked.add(input);
    this.held.clear();
    if (this.gripper) this.gripper_commands.cancelGripper();
    this.gripper = null;
    this.stopTimer();
    if (this.arm_kind) this.halt();
    for (const listener of this.release_listeners) listener();
  }

  /** Release every input of a page that nobody attends to: a key or finger that is let go elsewhere is not reported to it. */
  leave(): void {
    this.releaseAll();
    this.locked.clear();
  }

  private stopTimer(): void {
    clearInterval(this.timer);
    this.timer = undefined;
  }

  private commandsOf(kind: JogCommand["kind"]): JogCommand[] {
    return [...this.held.values()].filter((command) => command.kind === kind);
  }

  private isAllowed(): boolean {
    const { state } = this.store;
    return state.link.connected && denialReason("drive", state) === "" && isOneArm(state);
  }

  private send(): void {
    if (!this.isAllowed()) return this.releaseAll();
    if (this.arm_kind) this.publish(this.arm_kind, summed(this.commandsOf(this.arm_kind)));
    this.sendGripper(summed(this.commandsOf("gripper")).opening ?? 0);
  }

  private halt(): void {
    const kind = this.arm_kind;
    this.arm_kind = null;
    // Without a connection the command expires at the server by itself.
    if (kind && this.store.state.link.connected) this.publish(kind, {});
    // Inputs of the other kind that are still held go on.
    const rest = (["tip", "joints"] as const).find((each) => this.commandsOf(each).length > 0);
    if (rest) this.selectKind(rest);
  }

  private selectKind(kind: ArmKind): void {
    if (this.arm_kind === kind) return;
    this.arm_kind = kind;
    // Not waited for: the topic already decides, and the first command should not be later for it.
    const request = { command_type: COMMAND_TYPES[kind] };
    this.connection.call(`${this.namespace}/servo_node/switch_command_type`, request).catch((error: unknown) => {
      setNotice(this.store, "link", (error as Error).message);
    });
  }

  /** Choose the timeout with every press: after a stop the server follows no press from before, however late it arrives. */
  private announcePress(): void {
    this.connection.publish(`${this.namespace}/servo_node/command_timeout`, "std_msgs/Float64", { data: COMMAND_TIMEOUT_S });
  }

  private publish(kind: ArmKind, shares: Record<string, number>): void {
    const { command_in_type, linear_scale, rotational_scale, joint_scale } = this.store.state.servo_node;
    const unitless = command_in_type === "unitless";
    try {
      if (kind === "tip") {
        const frame_id = this.frame === "tool" ? (planningGroup(this.store.state)?.tip ?? "") : "";
        const message = twistStamped(frame_id, shares, unitless ? [1, 1] : [linear_scale, rotational_scale]);
        return this.connection.publish(`${this.namespace}/servo_node/delta_twist_cmds`, "geometry_msgs/TwistStamped", message);
      }
      const named = Object.keys(shares).length > 0 ? Object.keys(shares) : this.jogged;
      this.jogged = named.length > 0 ? named : armJoints(this.store.state).slice(0, 1);
      const factor = unitless ? 1 : joint_scale;
      const velocities = Object.fromEntries(this.jogged.map((name) => [name, (shares[name] ?? 0) * factor]));
      this.connection.publish(`${this.namespace}/servo_node/delta_joint_cmds`, "control_msgs/JointJog", jointJog(velocities));
    } catch (error) {
      this.releaseAll();
      setNotice(this.store, "link", (error as Error).message);
    }
  }

  /** Send the gripper a little further; without a servo topic it goes by small goals, so that a stall ends it as well. */
  private sendGripper(opening: number): void {
    const now_ms = performance.now();
    if (opening === 0 || (this.gripper && now_ms - this.gripper.sent_ms < GRIPPER_PERIOD_MS)) return;
    const position = openedBy(this.store.state, (opening * GRIPPER_PERIOD_MS) / 1000 / GRIPPER_RANGE_S, this.gripper?.position);
    if (position === null) return;
    if (position !== this.gripper?.position) void this.gripper_commands.moveGripper(position);
    this.gripper = { position, sent_ms: now_ms };
  }
}
