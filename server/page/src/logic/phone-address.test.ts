import { expect, test } from "vitest";
import { tokenFromUrl } from "../link/authentication";
import { modulePath, phoneAddress, phoneUrls } from "./phone-address";

test("the phone reads the token that the address carries", () => {
  expect(tokenFromUrl(phoneAddress("https://10.0.0.2:9090/", "a-b_c+%&#"))).toBe("a-b_c+%&#");
});

test("without a token the code just holds the address", () => {
  expect(phoneAddress("http://10.0.0.2:9090/", "")).toBe("http://10.0.0.2:9090/");
});

test.each([
  ["http://127.0.0.1:9090/", ["https://10.0.0.2:9090/"], ["https://10.0.0.2:9090/"]],
  ["http://localhost:9090/", [], []],
  ["https://[::1]:9090/", [], []],
  ["https://arm.local:9090/?x=1#y", ["https://10.0.0.2:9090/"], ["https://arm.local:9090/", "https://10.0.0.2:9090/"]],
  ["https://10.0.0.2:9090/", ["https://10.0.0.2:9090/"], ["https://10.0.0.2:9090/"]],
])("a page at %s offers a phone what it can open", (page, urls, expected) => {
  expect(phoneUrls(page, urls)).toEqual(expected);
});

test("each dark module is a square", () => {
  expect(modulePath(2, (row, column) => row === column)).toBe("M0 0h1v1h-1zM1 1h1v1h-1z");
});
