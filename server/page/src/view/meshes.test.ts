import { describe, expect, it } from "vitest";
import { meshUrl } from "./meshes";

describe("meshUrl", () => {
  const page = "http://h:9090/";
  it("looks below robot/", () => {
    expect(meshUrl("package://so101_description/a/b.stl", page)).toBe("http://h:9090/robot/so101_description/a/b.stl");
    expect(meshUrl("b.stl", page)).toBe("http://h:9090/robot/b.stl");
  });
  it("refuses what is elsewhere", () => {
    expect(meshUrl("package://../secret.stl", page)).toBeNull();
    expect(meshUrl("http://other/x.stl", page)).toBeNull();
    expect(meshUrl("//other/x.stl", page)).toBeNull();
    expect(meshUrl("file:///etc/x.stl", page)).toBeNull();
  });
});
