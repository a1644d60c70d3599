/** What was drawn, and how late. */
export interface DrawStats {
  /** Frames since the start. */
  frames: number;
  /** Messages of /joint_states since the start. */
  joint_states: number;
  /** Stamp of the joint state that is on the screen, in seconds. */
  drawn_stamp: number;
  /** From the newest message to the end of the frame that draws it. */
  age_ms: number;
  /** The longest of these. */
  age_max_ms: number;
  /** When the arm was first drawn, from the page's start; null before. */
  arm_drawn_ms: number | null;
  /** How long the last frame took to prepare and hand to the graphics. */
  frame_ms: number;
}

/** Counts frames, and finds how old a joint state is when it is on the screen. */
export class FrameCounter {
  private readonly stats: DrawStats = {
    frames: 0,
    joint_states: 0,
    drawn_stamp: 0,
    age_ms: 0,
    age_max_ms: 0,
    arm_drawn_ms: null,
    frame_ms: 0,
  };
  private came_ms: number | null = null;
  private stamp = 0;
  private began_ms = 0;

  /** A message of /joint_states has come. */
  came(stamp: number): void {
    this.stats.joint_states += 1;
    this.stamp = stamp;
    this.came_ms = performance.now();
  }

  /** A message of /joint_states has come that gives the picture that is on the screen. */
  cameAsDrawn(stamp: number): void {
    this.stats.joint_states += 1;
    this.stats.drawn_stamp = stamp;
    this.stats.age_ms = 0;
  }

  /** A frame begins. */
  begin(): void {
    this.began_ms = performance.now();
  }

  /** A frame was drawn, with the arm or without. */
  drawn(with_arm: boolean): void {
    const now_ms = performance.now();
    this.stats.frames += 1;
    this.stats.frame_ms = now_ms - this.began_ms;
    if (with_arm) this.stats.arm_drawn_ms ??= now_ms;
    if (!with_arm || this.came_ms === null) return;
    this.stats.drawn_stamp = this.stamp;
    this.stats.age_ms = now_ms - this.came_ms;
    this.stats.age_max_ms = Math.max(this.stats.age_max_ms, this.stats.age_ms);
    this.came_ms = null;
  }

  /** The figures of this moment. */
  read(): DrawStats {
    return { ...this.stats };
  }
}
