// The latest positions, as many as a picture can show: older ones go, however long the page is open.

import type { Vector } from "./protocol";

const MOST = 600;
/** Positions nearer than this to the last one of the trail are not added, m: a sensor at rest leaves none. */
const STEP_M = 0.004;

export class Trail {
  readonly points: Vector[] = [];
  version = 0;

  add(position: Vector): void {
    const last = this.points.at(-1);
    if (last && Math.hypot(...position.map((value, i) => value - last[i])) < STEP_M) return;
    this.points.push(position);
    if (this.points.length > MOST) this.points.shift();
    this.version++;
  }

  clear(): void {
    this.points.length = 0;
    this.version++;
  }
}
