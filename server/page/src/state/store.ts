import { batch, effect, signal, untracked, type Signal } from "@preact/signals";
import { NO_PLAN, type GoalSelection, type JointValues, type Orientation, type Point, type State } from "./state";

/**
 * State of which every part is a signal: a component or an effect that reads a part runs again when the part is replaced.
 *
 * Parts are replaced, never changed in place.
 */
export class Store<State extends object> {
  /** The newest parts. */
  readonly state: Readonly<State>;
  private readonly parts: { [Key in keyof State]: Signal<State[Key]> };

  constructor(initial: State) {
    const keys = Object.keys(initial) as (keyof State)[];
    this.parts = Object.fromEntries(keys.map((key) => [key, signal(initial[key])])) as typeof this.parts;
    const part = (key: keyof State): PropertyDescriptor => ({ enumerable: true, get: () => this.parts[key].value });
    this.state = Object.defineProperties({}, Object.fromEntries(keys.map((key) => [key, part(key)]))) as State;
  }

  set(patch: Partial<State>): void {
    batch(() => {
      for (const key of Object.keys(patch) as (keyof State)[]) this.parts[key].value = patch[key] as State[keyof State];
    });
  }

  patch<Key extends keyof State>(key: Key, patch: Partial<State[Key]>): void {
    this.set({ [key]: { ...this.parts[key].peek(), ...patch } } as unknown as Partial<State>);
  }

  /**
   * Call the listener at once, and whenever a part of the state is replaced (compared by identity).
   *
   * The error of one listener is reported, and keeps nothing from the others.
   *
   * @returns function that ends the subscription.
   */
  subscribe<Value>(selector: (state: State) => Value, listener: (value: Value, state: State) => void): () => void {
    let known: { value: Value } | null = null;
    return effect(() => {
      const value = selector(this.state);
      if (known !== null && Object.is(value, known.value)) return;
      known = { value };
      try {
        untracked(() => listener(value, this.state));
      } catch (error) {
        reportError(error);
      }
    });
  }
}

export type PageStore = Store<State>;

/** Call a function at every opening of the connection, and at once where it is open. */
export function onConnect(store: PageStore, act: () => void): void {
  store.subscribe((state) => state.link.connected, (connected) => connected && act());
}

/** Show a notice, which stays until its cause is gone; an empty text removes it. */
export function setNotice(store: PageStore, key: string, text: string): void {
  const { notices } = store.state;
  if ((notices.find((notice) => notice.key === key)?.text ?? "") === text) return;
  const others = notices.filter((notice) => notice.key !== key);
  store.set({ notices: text === "" ? others : [...others, { key, text }] });
}

/** Remove every notice with a key of this prefix. */
export function clearNotices(store: PageStore, prefix: string): void {
  const notices = store.state.notices;
  const others = notices.filter((notice) => !notice.key.startsWith(prefix));
  if (others.length < notices.length) store.set({ notices: others });
}

/** Select a goal, and remove the plan, which was made for another one. */
export function selectGoal(
  store: PageStore,
  kind: GoalSelection["kind"],
  joints_rad: JointValues | null,
  name = "",
): void {
  store.set({ selection: { kind, joints_rad, name }, plan: NO_PLAN });
}

/** Select a pose as the goal of the tool; without an orientation the point may be reached in any. */
export function selectTarget(store: PageStore, position_m: Point, orientation: Orientation | null = null): void {
  const { target } = store.state;
  store.set({
    selection: { kind: "target", joints_rad: null },
    target: { ...target, position_m: [...position_m], orientation },
    plan: NO_PLAN,
  });
}

/** Select the joint group that goals are for, and remove the goal of the group before. */
export function selectGroup(store: PageStore, group: string): void {
  if (group === store.state.group) return;
  store.set({ group, selection: { kind: "none", joints_rad: null }, plan: NO_PLAN });
}
