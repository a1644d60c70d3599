import { expect, test } from "vitest";
import { filteredLog, levelName, logLine } from "./log-filter";

const entry = (level: number, text: string, name = "armbridge.goals"): Parameters<typeof logLine>[0] => ({ stamp: 0, level, name, text });
const LOG = [entry(10, "Details"), entry(20, "goal 1 planned"), entry(30, "goal 2: warm", "armbridge.arm"), entry(50, "lost")];

test.each([
  [20, "", 3],
  [30, "", 2],
  [10, "GOAL 1", 1],
  [10, " arm.", 0],
  [10, "bridge.arm", 1],
  [40, "goal 2", 0],
])("from level %d with “%s” there are %d", (level, text, count) => {
  expect(filteredLog(LOG, level, text)).toHaveLength(count);
});

test.each([
  [5, "debug"],
  [20, "info"],
  [35, "warning"],
  [50, "error"],
])("level %d is %s", (level, name) => expect(levelName(level)).toBe(name));

test("a line has time, level, logger and text", () => {
  expect(logLine(entry(40, "lost"))).toBe("1970-01-01T00:00:00.000Z error armbridge.goals lost");
});
