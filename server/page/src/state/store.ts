import { noPlan, type GoalSelection, type JointValues, type Orientation, type Point, type State } from "./state";

/** Callback with the new value of the selected part, and with the whole state. */
type Listener<State, Value> = (value: Value, state: State) => void;

interface Subscription<State> {
  update: (state: State) => void;
}

/** State that is replaced, never changed in place, and notifies the subscribers of its parts. */
export class Store<State extends object> {
  private readonly subscriptions = new Set<Subscription<State>>();
  private current: State;

  /** @param initial - the state before the first change. */
  constructor(initial: State) {
    this.current = initial;
  }

  /** Newest state. */
  get state(): State {
    return this.current;
  }

  /** Replace parts of the state. */
  set(patch: Partial<State>): void {
    this.current = { ...this.current, ...patch };
    for (const subscription of [...this.subscriptions]) this.update(subscription);
  }

  /** Update a subscriber; the error of one is reported, and keeps nothing from the others. */
  private update(subscription: Subscription<State>): void {
    try {
      subscription.update(this.current);
    } catch (error) {
      queueMicrotask(() => {
        throw error;
      });
    }
  }

  /** Replace fields of one part of the state. */
  patch<Key extends keyof State>(key: Key, patch: Partial<State[Key]>): void {
    this.set({ [key]: { ...this.current[key], ...patch } } as unknown as Partial<State>);
  }

  /**
   * Call the listener at once, and whenever a part of the state is replaced (compared by identity).
   *
   * @returns function that ends the subscription.
   */
  subscribe<Value>(selector: (state: State) => Value, listener: Listener<State, Value>): () => void {
    let known = selector(this.current);
    const subscription: Subscription<State> = {
      update: (state) => {
        const value = selector(state);
        if (Object.is(value, known)) return;
        known = value;
        listener(value, state);
      },
    };
    this.subscriptions.add(subscription);
    listener(known, this.current);
    return () => this.subscriptions.delete(subscription);
  }

  /** Call the listener at once, and once for every replacement of any of these parts. */
  watch(parts: readonly (keyof State)[], listener: (state: State) => void): void {
    let known: unknown[] = [];
    const values = (state: State): unknown[] => {
      if (parts.some((part, index) => !Object.is(state[part], known[index]))) known = parts.map((part) => state[part]);
      return known;
    };
    this.subscribe(values, (_, state) => listener(state));
  }
}

/** Store of everything that the page shows. */
export type PageStore = Store<State>;

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
  store.set({ selection: { kind, joints_rad, name }, plan: noPlan() });
}

/**
 * Select a pose as the goal of the tool.
 *
 * @param orientation - null for a point that may be reached in any orientation.
 */
export function selectTarget(store: PageStore, position_m: Point, orientation: Orientation | null = null): void {
  const { target } = store.state;
  store.set({
    selection: { kind: "target", joints_rad: null },
    target: { ...target, position_m: [...position_m], orientation },
    plan: noPlan(),
  });
}

/** Select the joint group that goals are for, and remove the goal of the group before. */
export function selectGroup(store: PageStore, group: string): void {
  if (group === store.state.group) return;
  store.set({ group, selection: { kind: "none", joints_rad: null }, plan: noPlan() });
}
