import { expect, test } from "vitest";
import { authorization, serverUrl, tokenOf, withoutToken } from "./address";

test.each([
  ["http://h:9090/", null],
  ["http://h:9090/#token=a%2Bb", "a+b"],
  ["http://h:9090/#token=a+b/c=", "a+b/c="],
  ["http://h:9090/?x=1&token=abc", "abc"],
  ["http://h:9090/?token=abc#token=def", "def"],
  ["http://h:9090/#token=", null],
  ["http://h:9090/#panel", null],
])("%s has the token %s", (page, token) => {
  expect(tokenOf(page)).toBe(token);
});

test("an address without its token keeps the rest", () => {
  expect(withoutToken("http://h:9090/?x=1&token=abc#token=def")).toBe("http://h:9090/?x=1");
  expect(withoutToken("http://h:9090/#panel")).toBe("http://h:9090/#panel");
});

test("the server is where the page came from, without its token", () => {
  expect(serverUrl("http://h:9090/index.html?token=abc#token=def")).toBe("ws://h:9090/");
  expect(serverUrl("https://h/arm/")).toBe("wss://h/arm/");
});

test("a token is shown in the header of a file", () => {
  expect(authorization("a+b")).toEqual({ Authorization: "Bearer a+b" });
  expect(authorization(null)).toEqual({});
});
