/** Limit the rate of calls; the newest value is always delivered. */
export function throttle<Value>(period_ms: number, listener: (value: Value) => void): (value: Value) => void {
  let pending: { value: Value } | null = null;
  let last_ms = -Infinity;
  let _timer: ReturnType<typeof setTimeout> | null = null;
  const run = (): void => {
    _timer = null;
    if (!pending) return;
    const { value } = pending;
    pending = null;
    last_ms = performance.now();
    listener(value);
  };
  return (value) => {
    pending = { value };
    const due_ms = last_ms + period_ms - performance.now();
    if (due_ms <= 0) run();
    else _timer ??= setTimeout(run, due_ms);
  };
}
