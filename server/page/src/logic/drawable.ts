import type { SceneObject } from "../state/state";
import { shapeProblem } from "./shapes";

/** The things that can be drawn, and a sentence for each that cannot, as it is or in part. */
export function drawable(objects: readonly SceneObject[]): { objects: SceneObject[]; problems: string[] } {
  const problems: string[] = [];
  const drawn = objects.flatMap((object) => {
    if (![...object.position_m, ...object.orientation].every(Number.isFinite)) {
      problems.push(`“${object.id}” has no place that could be drawn.`);
      return [];
    }
    const wrong = object.shapes.map(shapeProblem);
    const problem = wrong.find((text) => text !== "");
    if (problem === undefined) return [object];
    problems.push(`“${object.id}” is not drawn as it is: ${problem}.`);
    return [{ ...object, shapes: object.shapes.filter((_, index) => wrong[index] === "") }];
  });
  return { objects: drawn, problems };
}
