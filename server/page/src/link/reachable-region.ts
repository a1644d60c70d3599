import { takesOrientation } from "../logic/joints";
import { reachOf, regionPoints, type RegionPoint } from "../logic/scene-region";
import type { Cell, State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Connection } from "./connection";
import { checkGoalsRequest, POINT_TOLERANCE_M, type GoalCheck } from "./messages";

/** Points of one request: few, so that a motion that is asked for meanwhile need not wait. */
const BATCH = 16;

/** Doubtful points of one request: so few share 45 ms, and not 5 ms each (docs/goals.md). */
const DOUBTFUL_BATCH = 4;

/** Pause between two requests [ms], and while the arm has a goal. */
const PAUSE_MS = 30;
const BUSY_PAUSE_MS = 500;

/** Time for an answer [s], many times that of the hardest points on a quiet machine. */
const TIMEOUT_S = 10;

/** Failures in a row after which the scan ends: a busy server answers later. */
const MAX_FAILURES = 5;

/** Computation of the reachable region in the background, begun anew with every change of the scene. */
export class RegionScan {
  private run = 0;
  /** Points that were free in any scene, of the present slice and arm alone. */
  private readonly free = new Set<string>();

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    // Before the scan begins again.
    for (const part of ["robot", "group"] as const) store.subscribe((state) => state[part], () => this.free.clear());
    store.subscribe((state) => state.region.slice, () => this.free.clear());
    for (const part of ["robot", "group", "objects"] as const) store.subscribe((state) => state[part], () => this.begin());
    const cause = ({ region, link }: State): string => JSON.stringify([region.shown, region.slice, link.connected]);
    store.subscribe(cause, () => this.begin());
  }

  private begin(): void {
    this.run += 1;
    const { region, robot, link } = this.store.state;
    const empty = region.cells.length === 0 && region.total === 0;
    if (!region.shown || !link.connected) {
      if (!empty) this.store.patch("region", { cells: [], total: 0, problem: "" });
      return;
    }
    const points = regionPoints(region.slice, robot?.reach_m ?? 0);
    this.store.patch("region", { cells: [], total: points.length, problem: "" });
    void this.scan(this.run, points);
  }

  private async scan(run: number, points: RegionPoint[]): Promise<void> {
    let failures = 0;
    for (let at = 0; at < points.length; ) {
      // Planning is more urgent than the picture.
      do await new Promise((resolve) => setTimeout(resolve, this.busy ? BUSY_PAUSE_MS : PAUSE_MS));
      while (this.busy && run === this.run);
      if (run !== this.run) return;
      const batch = points.slice(at, at + BATCH);
      try {
        const cells = await this.check(batch);
        if (run !== this.run) return;
        this.store.patch("region", { cells: [...this.store.state.region.cells, ...cells], problem: "" });
        at += BATCH;
        failures = 0;
      } catch (error) {
        if (run !== this.run) return;
        this.store.patch("region", { problem: t("world.region.failed", { reason: (error as Error).message }) });
        failures += 1;
        if (failures > MAX_FAILURES) return;
      }
    }
  }

  private get busy(): boolean {
    return this.store.state.active_goals.length > 0;
  }

  /** Return the answers for some points; those that something may be in the way of are checked with more time each. */
  private async check(batch: RegionPoint[]): Promise<Cell[]> {
    const cells = await this.ask(batch);
    const doubtful = batch.flatMap((_, at) => (cells[at]?.reach === "contact" ? [at] : []));
    for (let first = 0; first < doubtful.length; first += DOUBTFUL_BATCH) {
      const these = doubtful.slice(first, first + DOUBTFUL_BATCH);
      const again = await this.ask(batch.filter((_, at) => these.includes(at)));
      these.forEach((at, index) => (cells[at] = again[index] ?? cells[at]!));
    }
    return cells;
  }

  private async ask(points: RegionPoint[]): Promise<Cell[]> {
    const { state } = this.store;
    const orientation = takesOrientation(state) ? state.tool_orientation : null;
    const request = checkGoalsRequest(points.map(({ point_m }) => point_m), orientation);
    const { results } = await this.connection.call<{ results: GoalCheck[] }>("/check_goals", request, TIMEOUT_S);
    return points.flatMap((point, index) => {
      const result = results[index];
      if (result === undefined) return [];
      const key = point.point_m.join();
      const reach = reachOf(result, POINT_TOLERANCE_M, this.free.has(key));
      if (reach === "free") this.free.add(key);
      return [{ ...point, reach }];
    });
  }
}
