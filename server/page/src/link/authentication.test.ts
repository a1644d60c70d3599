import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { emptyState } from "../state/state";
import { Store, type PageStore } from "../state/store";
import { Authentication, authorizationHeaders, storedToken, storeToken, takeTokenFromUrl, tokenFromUrl, urlWithoutToken } from "./authentication";
import type { Connection } from "./connection";

test.each([
  ["http://h:9090/", null],
  ["http://h:9090/#token=a%2Bb", "a+b"],
  ["http://h:9090/#token=a+b/c=", "a+b/c="],
  ["http://h:9090/?x=1&token=abc", "abc"],
  ["http://h:9090/?token=abc#token=def", "def"],
  ["http://h:9090/#token=", null],
  ["http://h:9090/#panel", null],
])("%s has the token %s", (page, token) => {
  expect(tokenFromUrl(page)).toBe(token);
});

test("an address without its token keeps the rest", () => {
  expect(urlWithoutToken("http://h:9090/?x=1&token=abc#token=def")).toBe("http://h:9090/?x=1");
  expect(urlWithoutToken("http://h:9090/#panel")).toBe("http://h:9090/#panel");
});

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

function authentication(): { authentication: Authentication; store: PageStore; reopen: ReturnType<typeof vi.fn> } {
  const store = new Store(emptyState("ws://here"));
  const reopen = vi.fn();
  return { authentication: new Authentication({ reopen } as unknown as Connection, store), store, reopen };
}

test("a token is shown in the header of a file", () => {
  expect(authorizationHeaders()).toEqual({});
  storeToken("a+b");
  expect(authorizationHeaders()).toEqual({ Authorization: "Bearer a+b" });
  storeToken(null);
});

test("a rejected page asks for a token, and connects anew with it", () => {
  const setup = authentication();
  setup.store.patch("link", { refused: "the first message must be auth" });
  expect(setup.store.state.token).toEqual({ held: false, asked: true });
  setup.authentication.authenticate("secret");
  expect(setup.store.state.token).toEqual({ held: true, asked: false });
  expect([storedToken(), setup.reopen.mock.calls.length]).toEqual(["secret", 1]);
});

test("a token is forgotten when the user goes on without one", () => {
  const setup = authentication();
  setup.authentication.authenticate("secret");
  setup.authentication.authenticate(null);
  expect([storedToken(), kept.size, setup.store.state.token.held]).toEqual([null, 0, false]);
});

test("the token of the address is kept for the tab, and stands there no more", () => {
  location.href = "http://h:9090/?x=1#token=secret";
  expect(takeTokenFromUrl()).toBe(true);
  expect([storedToken(), location.href]).toEqual(["secret", "http://h:9090/?x=1"]);
  expect(takeTokenFromUrl()).toBe(false);
});

test("an address with a token, put into an open page, is used at once", () => {
  const setup = authentication();
  hashChanged();
  expect(setup.reopen).not.toHaveBeenCalled();
  location.href = "http://h:9090/#token=secret";
  hashChanged();
  expect([storedToken(), setup.reopen.mock.calls.length]).toEqual(["secret", 1]);
});

test("without storage the token lasts until the page is loaded again", () => {
  const refuse = (): never => {
    throw new Error("blocked");
  };
  vi.stubGlobal("sessionStorage", { getItem: refuse, setItem: refuse, removeItem: refuse });
  authentication().authentication.authenticate("secret");
  expect(storedToken()).toBe("secret");
  authentication().authentication.authenticate(null);
  expect(storedToken()).toBeNull();
});
