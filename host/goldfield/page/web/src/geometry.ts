// What pictures need of vectors, matrices and quaternions.

import type { Matrix, Vector } from "./protocol";

/** Radius of the region that holds 95 % of a normal distribution, in standard deviations, in two and three dimensions. */
export const RADIUS_95 = { plane: 2.448, space: 2.796 };

/** Return the lower triangle L with L Lᵀ = m: it takes the unit sphere to the ellipsoid of a covariance. */
export function cholesky(m: Matrix): Matrix | null {
  const l: Matrix = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = m[i][j];
      for (let k = 0; k < j; k++) sum -= l[i][k] * l[j][k];
      if (i === j && sum <= 0) return null;
      l[i][j] = i === j ? Math.sqrt(sum) : sum / l[j][j];
    }
  }
  return l;
}

/** Return the rotation matrix of a unit quaternion (x, y, z, w); its columns are the sensor's axes in the site. */
export function rotation([x, y, z, w]: [number, number, number, number]): Matrix {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
}

/** Return yaw, pitch and roll in degrees: turns about z, then the new y, then the new x. */
export function yawPitchRoll(r: Matrix): Vector {
  const degrees = 180 / Math.PI;
  const pitch = Math.asin(Math.max(-1, Math.min(1, -r[2][0])));
  return [Math.atan2(r[1][0], r[0][0]) * degrees, pitch * degrees, Math.atan2(r[2][1], r[2][2]) * degrees];
}

export function trace(m: Matrix): number {
  return m[0][0] + m[1][1] + m[2][2];
}

/** Return 1, 10, 100, ... : by what a small thing is drawn larger, to be at least `least` of the whole. */
export function magnification(size: number, whole: number, least = 0.02): number {
  if (!(size > 0)) return 1;
  return Math.min(1000, Math.max(1, 10 ** Math.ceil(Math.log10((least * whole) / size) - 1e-9)));
}

/** Return a step of 1, 2 or 5 times a power of ten with which a length has about so many parts. */
export function niceStep(length: number, parts: number): number {
  const raw = length / parts;
  const power = 10 ** Math.floor(Math.log10(raw));
  return ([1, 2, 5].find((f) => f * power >= raw) ?? 10) * power;
}

export function size(low: Vector, high: Vector): number {
  return Math.max(...low.map((value, i) => high[i] - value));
}
