// The pose in figures: position, attitude, how far each may be off, and what the pose rests on. Their cells stand in the
// page itself, so that they have their place before this runs.

import { byId, setText } from "./dom";
import { rotation, trace, yawPitchRoll } from "./geometry";
import type { Pose } from "./protocol";
import { figure, length } from "./words";

/** Beacons that are left out are named as long as their names have room; the table names them all. */
const MOST_NAMED = 2;

export function showFigures(pose: Pose): void {
  const cov = pose.position_cov_m2;
  (["x", "y", "z"] as const).forEach((name, i) => {
    show(name, pose.position_m ? `${figure(pose.position_m[i], 3)} m` : "–", cov ? `± ${figure(Math.sqrt(cov[i][i]), 1, 1000)} mm` : "");
  });
  const angles = pose.orientation_xyzw ? yawPitchRoll(rotation(pose.orientation_xyzw)) : null;
  const off = pose.attitude_cov_rad2 ? (Math.sqrt(trace(pose.attitude_cov_rad2) / 3) * 180) / Math.PI : null;
  (["yaw", "pitch", "roll"] as const).forEach((name, i) => {
    show(name, angles ? `${figure(angles[i], 1)}°` : "–", off === null ? "" : `± ${figure(off, 2)}°`);
  });
  show("protection", pose.protection_m === null ? "none" : length(pose.protection_m), "");
  show("residual", figure(pose.residual, 2), "");
  const without = pose.excluded.length > MOST_NAMED ? `${pose.excluded.length} left out` : `without ${pose.excluded.join(", ")}`;
  show("beacons", `${pose.used.length} used`, pose.excluded.length ? without : "");
}

function show(name: string, value: string, off: string): void {
  const cell = byId(`figure-${name}`);
  setText(cell.children[0], value);
  setText(cell.children[1], off);
}
