import { expect, test } from "vitest";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { hearControl } from "./control";
import type { Link } from "./link";
import type { DiagnosticStatus } from "./wire";

const ME = JSON.stringify({ name: "alice (10.0.0.1:5)", address: "10.0.0.1:5", role: "operate" });

function heard(call: () => Promise<unknown>): { store: Store<State>; tell: (status: DiagnosticStatus) => void } {
  const store = new Store(emptyState("ws://here"));
  let tell: (status: DiagnosticStatus) => void = () => undefined;
  const subscribe = (_topic: string, _type: string, listener: typeof tell): void => void (tell = listener);
  hearControl({ subscribe, call } as unknown as Link, store);
  return { store, tell: (status) => tell(status) };
}

test("the page learns who it is, and forgets it with the connection", async () => {
  const { store } = heard(() => Promise.resolve({ success: true, message: ME }));
  store.patch("link", { connected: true });
  await Promise.resolve();
  expect(store.state.identity).toEqual({ address: "10.0.0.1:5", role: "operate" });
  store.patch("link", { connected: false });
  expect(store.state.identity).toBeNull();
});

test("a server that does not tell leaves it unknown", async () => {
  const { store } = heard(() => Promise.reject(new Error("no such service")));
  store.patch("link", { connected: true });
  await Promise.resolve();
  expect(store.state.identity).toBeNull();
});

test("who drives is shown as it comes", () => {
  const { store, tell } = heard(() => Promise.reject(new Error("nobody")));
  const values = [{ key: "address", value: "10.0.0.1:6" }, { key: "policy", value: "lease" }, { key: "free_in_s", value: "7" }];
  tell({ level: 0, name: "control", message: "", hardware_id: "bob", values });
  expect(store.state.control).toEqual({ holder: "bob", address: "10.0.0.1:6", policy: "lease", free_in_s: 7 });
});
