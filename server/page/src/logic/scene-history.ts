import type { SceneChange, SceneObject } from "../state/state";

/** Number of changes that can be undone. */
export const MAX_CHANGES = 20;

/** Return how the named objects are now, for undoing a change of them. */
export function before(ids: readonly string[], objects: readonly SceneObject[]): SceneChange {
  const of = (id: string): SceneObject | null => objects.find((object) => object.id === id) ?? null;
  return { objects: Object.fromEntries(ids.map((id) => [id, of(id)])), whole: false };
}

/** Return how all objects are now, for undoing the replacement of the scene. */
export function beforeReplacement(objects: readonly SceneObject[]): SceneChange {
  return { objects: Object.fromEntries(objects.map((object) => [object.id, object])), whole: true };
}

/** Return the history with one more change; the oldest is forgotten. */
export function withChange(history: readonly SceneChange[], change: SceneChange): SceneChange[] {
  return [...history, change].slice(-MAX_CHANGES);
}

/** Difference of the scene, as objects. */
export interface SceneDifference {
  /** Objects that stand in the world afterwards. */
  added: SceneObject[];
  /** Objects that links hold afterwards, each in the frame of its link. */
  attached: SceneObject[];
  detached: string[];
  removed: string[];
}

/** Return the difference that brings objects back to how they were; what is as it was is left alone. */
export function undoing(change: SceneChange, objects: readonly SceneObject[]): SceneDifference {
  const difference: SceneDifference = { added: [], attached: [], detached: [], removed: [] };
  const others = change.whole ? objects.filter(({ id }) => !(id in change.objects)).map(({ id }) => id) : [];
  const earlier_of: SceneChange["objects"] = { ...change.objects, ...Object.fromEntries(others.map((id) => [id, null])) };
  for (const [id, earlier] of Object.entries(earlier_of)) {
    const present = objects.find((object) => object.id === id);
    if (present === earlier || (present === undefined && earlier === null)) continue;
    if (earlier?.attached) difference.attached.push(earlier);
    // An object that a link holds must be detached before the world can have it, or lose it.
    else if (present?.attached) difference.detached.push(id);
    if (earlier === null) difference.removed.push(id);
    else if (!earlier.attached) difference.added.push(earlier);
  }
  return difference;
}
