import { expect, test } from "vitest";
import { childrenOf, numberOf, readXml } from "./xml";

test("elements, attributes in either quotes and entities are read, comments are not", () => {
  const root = readXml(`<?xml version="1.0"?>
    <!-- <robot name="no"/> -->
    <robot name="a &amp; b"><joint name='j' ><limit lower="-1.5"
      upper='2'/></joint><link name="l"/>text</robot>`);
  expect(root?.attributes).toEqual({ name: "a & b" });
  const [joint] = childrenOf(root, "joint");
  expect(joint?.attributes.name).toBe("j");
  expect(numberOf(childrenOf(joint ?? null, "limit")[0], "lower")).toBe(-1.5);
  expect(numberOf(childrenOf(joint ?? null, "limit")[0], "velocity")).toBeNaN();
  expect(childrenOf(root, "link")).toHaveLength(1);
});

test.each(["", "no XML", "<", "</robot>"])("%j has no root", (text) => {
  expect(readXml(text)).toBeNull();
});

test("a text of a megabyte is read in time", () => {
  const joint = '<joint name="j" type="fixed"><origin xyz="0 0 0" rpy="0 0 0"/></joint>\n';
  const root = readXml(`<robot>${joint.repeat(15_000)}</robot>`);
  expect(root?.children).toHaveLength(15_000);
});
