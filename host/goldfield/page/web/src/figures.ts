// The pose in figures: position, attitude, how far each may be off, and what the pose rests on.

import { make, setText } from "./dom";
import { rotation, trace, yawPitchRoll } from "./geometry";
import type { Pose } from "./protocol";
import { figure, length } from "./words";

const NAMES = ["x", "y", "z", "yaw", "pitch", "roll", "protection", "residual", "beacons"] as const;

export class Figures {
  private readonly cells = new Map<string, [HTMLElement, HTMLElement]>();

  constructor(host: HTMLElement) {
    for (const name of NAMES) {
      const [value, off] = [make("span", { class: "value" }, "–"), make("span", { class: "off" })];
      host.append(make("div", {}, make("dt", {}, name), make("dd", {}, value, " ", off)));
      this.cells.set(name, [value, off]);
    }
  }

  set(pose: Pose): void {
    const cov = pose.position_cov_m2;
    (["x", "y", "z"] as const).forEach((name, i) => {
      this.show(name, pose.position_m ? `${figure(pose.position_m[i], 3)} m` : "–", cov ? `± ${figure(Math.sqrt(cov[i][i]), 1, 1000)} mm` : "");
    });
    const angles = pose.orientation_xyzw ? yawPitchRoll(rotation(pose.orientation_xyzw)) : null;
    const off = pose.attitude_cov_rad2 ? (Math.sqrt(trace(pose.attitude_cov_rad2) / 3) * 180) / Math.PI : null;
    (["yaw", "pitch", "roll"] as const).forEach((name, i) => {
      this.show(name, angles ? `${figure(angles[i], 1)}°` : "–", off === null ? "" : `± ${figure(off, 2)}°`);
    });
    this.show("protection", pose.protection_m === null ? "none" : length(pose.protection_m), "");
    this.show("residual", figure(pose.residual, 2), "");
    this.show("beacons", `${pose.used.length} used`, pose.excluded.length ? `without ${pose.excluded.join(", ")}` : "");
  }

  private show(name: string, value: string, off: string): void {
    const cells = this.cells.get(name);
    if (!cells) return;
    setText(cells[0], value);
    setText(cells[1], off);
  }
}
