/** Called with the new value, and with the whole state for what else it needs. */
type Listener<State, Value> = (value: Value, state: State) => void;

interface Watch<State> {
  look: (state: State) => void;
}

/** Holds the state, and tells those who watch a part of it when that part is another. */
export class Store<State extends object> {
  private readonly watches = new Set<Watch<State>>();
  private current: State;

  /** @param initial - the state before the first change. */
  constructor(initial: State) {
    this.current = initial;
  }

  /** The newest state; never changed in place. */
  get state(): State {
    return this.current;
  }

  /** Replace parts of the state. */
  set(patch: Partial<State>): void {
    this.current = { ...this.current, ...patch };
    for (const watch of [...this.watches]) watch.look(this.current);
  }

  /** Replace fields of one part of the state. */
  patch<Key extends keyof State>(key: Key, patch: Partial<State[Key]>): void {
    this.set({ [key]: { ...this.current[key], ...patch } } as unknown as Partial<State>);
  }

  /**
   * Watch a part of the state; the listener is called at once, and whenever the part is another (by identity).
   *
   * @returns ends the watching.
   */
  subscribe<Value>(selector: (state: State) => Value, listener: Listener<State, Value>): () => void {
    let known = selector(this.current);
    const watch: Watch<State> = {
      look: (state) => {
        const value = selector(state);
        if (Object.is(value, known)) return;
        known = value;
        listener(value, state);
      },
    };
    this.watches.add(watch);
    listener(known, this.current);
    return () => this.watches.delete(watch);
  }
}
