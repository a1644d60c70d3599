/** Let a listener hear at most so often; the newest call is never lost. */
export function paced<Value>(least_ms: number, listener: (value: Value) => void): (value: Value) => void {
  let waiting: { value: Value } | null = null;
  let last_ms = -Infinity;
  let timer: ReturnType<typeof setTimeout> | null = null;
  const run = (): void => {
    timer = null;
    if (!waiting) return;
    const { value } = waiting;
    waiting = null;
    last_ms = performance.now();
    listener(value);
  };
  return (value) => {
    waiting = { value };
    const due_ms = last_ms + least_ms - performance.now();
    if (due_ms <= 0) run();
    else timer ??= setTimeout(run, due_ms);
  };
}
