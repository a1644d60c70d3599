import type { JointValues, StudentArm } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { storedToken } from "./authentication";
import { ask, Connection } from "./connection";
import { readArmState, valuesByJoint, type JointState, type TriggerResponse } from "./messages";

/** Least time between two poses of an arm [ms]: each is a picture to draw, and a class has many arms. */
const POSE_PERIOD_MS = 1000;

/** Step of joint values that is seen in a small picture [rad or m]. */
const SEEN_STEP = 0.05;

/** Arms of a classroom, each on a server of its own, to which the page connects while it shows them. */
export class Classroom {
  private readonly connections = new Map<string, Connection>();

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    connection.subscribe("/armbridge/classroom", "std_msgs/msg/String", ({ data }) => {
      const ports = Object.entries(JSON.parse(data) as Record<string, number>);
      store.set({ classroom: ports.map(([name, port]) => ({ name, port, connected: false, arm: null, seen_rad: {} })) });
    });
  }

  /** Connect to the server of every arm; return the function that ends it. */
  watch(): () => void {
    for (const { name, port } of this.store.state.classroom) {
      const url = new URL(this.connection.url);
      url.port = String(port);
      const own = new Connection(url.href, ({ connected }) => this.patch(name, { connected }), storedToken);
      this.connections.set(name, own);
      own.subscribe("/arm/state", "diagnostic_msgs/msg/DiagnosticStatus", (status) => this.patch(name, { arm: readArmState(status) }));
      own.subscribe("/joint_states", "sensor_msgs/msg/JointState", (joints) => this.patch(name, { seen_rad: seen(joints) }), POSE_PERIOD_MS);
      own.open();
    }
    return () => {
      for (const [name, own] of this.connections) {
        own.close();
        this.patch(name, { connected: false });
      }
      this.connections.clear();
    };
  }

  async stop(name: string): Promise<string> {
    return (await this.request(name, "/arm/stop")) || t("stop.stands");
  }

  /** End an arm's fault, or hold it again; return the server's sentence. */
  async reset(name: string): Promise<string> {
    const arm = this.store.state.classroom.find((each) => each.name === name)?.arm;
    // The student's program may have the control, which nobody else may take for some seconds once it was taken away.
    await this.request(name, "/arm/release_control");
    const told = await this.request(name, arm?.mode === "relaxed" ? "/arm/enable" : "/arm/reset_fault");
    await this.request(name, "/arm/release_control");
    return told;
  }

  private async request(name: string, service: string): Promise<string> {
    const own = this.connections.get(name);
    return own === undefined ? "" : (await ask<TriggerResponse>(own, service, {})).message;
  }

  private patch(name: string, patch: Partial<StudentArm>): void {
    this.store.set({ classroom: this.store.state.classroom.map((each) => (each.name === name ? { ...each, ...patch } : each)) });
  }
}

/** Return joint values in steps that can be seen, so that an arm at rest is drawn once. */
function seen({ name, position }: JointState): JointValues {
  return valuesByJoint(name, position.map((value) => Math.round(value / SEEN_STEP) * SEEN_STEP));
}
