/**
 * Return the indices of the points that are kept of a path, so that no value of another point is further than a tolerance
 * from the straight line between its kept neighbours; after Douglas and Peucker, 1973.
 *
 * @param path - points of as many values each.
 */
export function simplified(path: readonly (readonly number[])[], tolerance: number): number[] {
  if (path.length === 0) return [];
  const kept = new Set([0, path.length - 1]);
  const ranges: [number, number][] = [[0, path.length - 1]];
  for (let range = ranges.pop(); range !== undefined; range = ranges.pop()) {
    const [first, last] = range;
    let [worst, away] = [first, tolerance];
    for (let index = first + 1; index < last; index++) {
      const here = distance(path, first, index, last);
      if (here > away) [worst, away] = [index, here];
    }
    if (worst === first) continue;
    kept.add(worst);
    ranges.push([first, worst], [worst, last]);
  }
  return [...kept].sort((a, b) => a - b);
}

/** Return the greatest difference of a value from that of the nearest point of the line between two others. */
function distance(path: readonly (readonly number[])[], first: number, index: number, last: number): number {
  const [from, at, to] = [path[first] ?? [], path[index] ?? [], path[last] ?? []];
  const way = to.map((value, column) => value - (from[column] ?? 0));
  const length = way.reduce((sum, value) => sum + value * value, 0);
  const along = at.reduce((sum, value, column) => sum + (value - (from[column] ?? 0)) * (way[column] ?? 0), 0);
  const share = length > 0 ? Math.min(Math.max(along / length, 0), 1) : 0;
  return Math.max(...at.map((value, column) => Math.abs(value - (from[column] ?? 0) - share * (way[column] ?? 0))));
}
