import { describe, expect, it } from "vitest";
import { meshUrl, readBounded } from "./meshes";

function stream(chunks: number, cancelled: () => void = () => undefined): Response {
  let left = chunks;
  const body = new ReadableStream<Uint8Array>({
    pull(controller) {
      if (left === 0) controller.close();
      else controller.enqueue(new Uint8Array(1000).fill(left--));
    },
    cancel: cancelled,
  });
  return new Response(body);
}

describe("readBounded", () => {
  it("joins what comes", async () => {
    const bytes = await readBounded(stream(3), 3000);
    expect([bytes.length, bytes[0], bytes[2999]]).toEqual([3000, 3, 1]);
  });
  it("stops at the limit", async () => {
    let stopped = false;
    await expect(readBounded(stream(1e6, () => (stopped = true)), 2500)).rejects.toThrow("larger than the 1 MB");
    expect(stopped).toBe(true);
  });
  it("refuses by the told size before reading", async () => {
    const answer = new Response("x", { headers: { "content-length": "100000000" } });
    await expect(readBounded(answer, 30e6)).rejects.toThrow("30 MB that the page loads (100 MB and more)");
  });
  it("takes an empty answer", async () => {
    expect((await readBounded(new Response(null), 10)).length).toBe(0);
  });
});

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
