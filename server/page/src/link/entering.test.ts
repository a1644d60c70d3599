import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { heldToken, takeTokenOfAddress } from "../state/token";
import { Entering } from "./entering";
import type { Link } from "./link";

let kept: Map<string, string>;
let hashChanged: () => void;

beforeEach(() => {
  kept = new Map();
  const page = { href: "http://h:9090/" };
  vi.stubGlobal("sessionStorage", {
    getItem: (key: string) => kept.get(key) ?? null,
    setItem: (key: string, value: string) => kept.set(key, value),
    removeItem: (key: string) => kept.delete(key),
  });
  vi.stubGlobal("location", page);
  vi.stubGlobal("history", { replaceState: (_state: unknown, _title: string, href: string) => (page.href = href) });
  vi.stubGlobal("window", { addEventListener: (_: string, listener: () => void) => (hashChanged = listener) });
});

afterEach(() => vi.unstubAllGlobals());

function entering(): { entering: Entering; store: Store<State>; reopen: ReturnType<typeof vi.fn> } {
  const store = new Store(emptyState("ws://here"));
  const reopen = vi.fn();
  return { entering: new Entering({ reopen } as unknown as Link, store), store, reopen };
}

test("who is not let in is asked for a token, and with one the page connects anew", () => {
  const e = entering();
  e.store.patch("link", { refused: "the first message must be auth" });
  expect(e.store.state.token).toEqual({ held: false, asked: true });
  e.entering.enter("secret");
  expect(e.store.state.token).toEqual({ held: true, asked: false });
  expect([heldToken(), e.reopen.mock.calls.length]).toEqual(["secret", 1]);
});

test("a token is forgotten when the user goes on without one", () => {
  const e = entering();
  e.entering.enter("secret");
  e.entering.enter(null);
  expect([heldToken(), kept.size, e.store.state.token.held]).toEqual([null, 0, false]);
});

test("the token of the address is kept for the tab, and stands there no more", () => {
  location.href = "http://h:9090/?x=1#token=secret";
  expect(takeTokenOfAddress()).toBe(true);
  expect([heldToken(), location.href]).toEqual(["secret", "http://h:9090/?x=1"]);
  expect(takeTokenOfAddress()).toBe(false);
});

test("an address with a token, put into an open page, is used at once", () => {
  const e = entering();
  hashChanged();
  expect(e.reopen).not.toHaveBeenCalled();
  location.href = "http://h:9090/#token=secret";
  hashChanged();
  expect([heldToken(), e.reopen.mock.calls.length]).toEqual(["secret", 1]);
});

test("where the browser keeps nothing the token lasts until the page is loaded again", () => {
  const refuse = (): never => {
    throw new Error("blocked");
  };
  vi.stubGlobal("sessionStorage", { getItem: refuse, setItem: refuse, removeItem: refuse });
  entering().entering.enter("secret");
  expect(heldToken()).toBe("secret");
  entering().entering.enter(null);
  expect(heldToken()).toBeNull();
});
