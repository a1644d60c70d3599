import type { SceneChange, SceneObject } from "../state/state";

export const MAX_CHANGES = 20;

/** Return the history with one more change; the oldest is forgotten. */
export function withChange(history: readonly SceneChange[], change: SceneChange): SceneChange[] {
  return [...history, change].slice(-MAX_CHANGES);
}

export interface SceneDifference {
  added: SceneObject[];
  /** Objects that links hold afterwards, each in the frame of its link. */
  attached: SceneObject[];
  detached: string[];
  removed: string[];
}

/** Return the difference that brings objects back to how they were; what is as it was is left alone. */
export function undoing({ ids, objects: earlier_objects }: SceneChange, objects: readonly SceneObject[]): SceneDifference {
  const difference: SceneDifference = { added: [], attached: [], detached: [], removed: [] };
  for (const id of ids ?? new Set([...earlier_objects, ...objects].map((object) => object.id))) {
    const earlier = earlier_objects.find((object) => object.id === id);
    const present = objects.find((object) => object.id === id);
    if (present === earlier) continue;
    if (earlier?.attached) difference.attached.push(earlier);
    // An object that a link holds must be detached before the world can have it, or lose it.
    else if (present?.attached) difference.detached.push(id);
    if (earlier === undefined) difference.removed.push(id);
    else if (!earlier.attached) difference.added.push(earlier);
  }
  return difference;
}
