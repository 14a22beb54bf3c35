// What states, statuses and numbers are called, how they are marked, and what to do about them.

import type { BeaconHealth } from "./protocol";

/** A tone is a colour; it always comes with a mark and a word, so that nothing is told by colour alone. */
export type Tone = "good" | "warn" | "bad" | "idle";

export interface Said {
  tone: Tone;
  mark: string;
  word: string;
}

export interface StatusSaid extends Said {
  meaning: string;
  advice: string;
}

export const STATUS: Record<string, StatusSaid> = {
  ok: { tone: "good", mark: "✓", word: "ok", meaning: "Sound: no single fault could hide a larger error than the alert limit.", advice: "" },
  unverified: {
    tone: "warn", mark: "!", word: "unverified",
    meaning: "It fits, but one beacon’s fault could hide an error above the alert limit.",
    advice: "Come nearer to more beacons, add a beacon, or bear a larger alert limit.",
  },
  weak: {
    tone: "warn", mark: "▽", word: "weak", meaning: "The beacons that are heard do not fix the pose.",
    advice: "Come nearer, or see why beacons are missing in the table below.",
  },
  ambiguous: {
    tone: "warn", mark: "≟", word: "ambiguous", meaning: "Two poses fit the fields.",
    advice: "Say in the site file on which side the sensor is (half space), or add a beacon off the plane of the others.",
  },
  inconsistent: {
    tone: "bad", mark: "✗", word: "inconsistent", meaning: "No pose fits the fields of a clear majority, or a board is wrong.",
    advice: "See which beacons do not fit in the table; “goldfield doctor” examines the installation.",
  },
  failed: {
    tone: "bad", mark: "✗", word: "failed", meaning: "There is no pose.",
    advice: "Check that the beacons are on and that the sensor is among them; “goldfield doctor” examines the installation.",
  },
};

export const LINK: Record<string, Said> = {
  connecting: { tone: "idle", mark: "○", word: "connecting" },
  gone: { tone: "bad", mark: "✗", word: "page cut off" },
  waiting: { tone: "idle", mark: "○", word: "waiting for the sensor" },
  running: { tone: "good", mark: "●", word: "live" },
  playing: { tone: "good", mark: "▶", word: "playing" },
  silent: { tone: "bad", mark: "✗", word: "stream stopped" },
  lost: { tone: "bad", mark: "✗", word: "link lost" },
  busy: { tone: "idle", mark: "…", word: "computing" },
  ended: { tone: "idle", mark: "■", word: "ended" },
  played: { tone: "idle", mark: "■", word: "recording ended" },
};

/** A beacon's field may differ so much from the expected one before it is called off. */
const STRENGTH_OFF = 0.05;

export function beaconSaid(health: BeaconHealth | undefined): Said {
  if (!health) return { tone: "idle", mark: "○", word: "no word yet" };
  if (health.measured_T === null) return { tone: "bad", mark: "✗", word: "not heard" };
  if (!health.used) return { tone: "bad", mark: "▲", word: "left out" };
  if (health.ratio !== null && Math.abs(health.ratio - 1) > STRENGTH_OFF) return { tone: "warn", mark: "◆", word: "strength off" };
  return { tone: "good", mark: "●", word: "used" };
}

export function figure(value: number | null | undefined, decimals: number, scale = 1): string {
  return value === null || value === undefined || !Number.isFinite(value) ? "–" : (value * scale).toFixed(decimals).replace("-", "−");
}

/** Return a length in words that keep three digits: 1.23 m, 45.6 cm, 7.89 mm. */
export function length(metres: number | null): string {
  if (metres === null || !Number.isFinite(metres)) return "–";
  if (metres >= 1) return `${metres.toFixed(2)} m`;
  return metres >= 0.01 ? `${(100 * metres).toFixed(1)} cm` : `${(1000 * metres).toFixed(2)} mm`;
}
