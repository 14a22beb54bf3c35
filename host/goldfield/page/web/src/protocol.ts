// The messages that the server sends, as host/goldfield/page/greeting.py, messages.py and hub.py make them; docs/live_page.md explains the keys.

export const PROTOCOL = 1;

export type Vector = [number, number, number];
export type Matrix = [Vector, Vector, Vector];

export interface SiteBeacon {
  id: string;
  code: number;
  position_m: Vector;
  axis: Vector;
  wire_m: Vector[];
}

export interface Site {
  name: string;
  cycle_s: number;
  alert_limit_m: number | null;
  box: { low_m: Vector; high_m: Vector };
  half_space: { point_m: Vector; normal: Vector } | null;
  beacons: SiteBeacon[];
}

export interface Hello {
  type: "hello";
  protocol: number;
  source: string;
  live: boolean;
  site: Site;
}

export interface Pose {
  t_s: number | null;
  position_m: Vector | null;
  orientation_xyzw: [number, number, number, number] | null;
  position_cov_m2: Matrix | null;
  attitude_cov_rad2: Matrix | null;
  residual: number | null;
  status: string;
  used: string[];
  excluded: string[];
  reason: string | null;
  protection_m: number | null;
  beacons: Record<string, number | null>;
}

export interface Alarm {
  kind: string;
  beacons: string[];
  text: string;
}

export interface Epoch extends Pose {
  type: "epoch";
  epoch: number;
  at_rate: boolean;
  lost: number;
  chips: number | null;
  saturated: number | null;
  locked: boolean | null;
  noise_T: number | null;
  alarms: Alarm[];
}

export interface Fix extends Pose {
  type: "fix";
}

export interface BeaconHealth {
  measured_T: number | null;
  expected_T: number | null;
  ratio: number | null;
  residual: number | null;
  used: boolean;
  node: number | null;
  current_A: number | null;
}

export interface Board {
  role: string | null;
  state: string | null;
  version: string | null;
  locked: boolean | null;
  phase_s: number | null;
  temperature_degC: number | null;
  coil_degC: number | null;
  driver_degC: number | null;
  supply_V: number | null;
  complaints: string[];
  counters: Record<string, number>;
}

export interface Health {
  type: "health";
  t_s: number | null;
  node: number | null;
  cycles_per_s: number | null;
  lost: number;
  lost_in_all: number;
  beacons: Record<string, BeaconHealth>;
  boards: Record<string, Board>;
}

export interface State {
  type: "state";
  state: "waiting" | "running" | "silent" | "lost" | "busy" | "ended";
  text: string;
  silent_s: number;
}

export interface Progress {
  type: "progress";
  task: string;
  text: string;
  share: number | null;
  rows: { name: string; text: string; share: number | null }[];
}

export interface Dropped {
  type: "dropped";
  count: number;
}

export type Message = Hello | Epoch | Fix | Health | Progress | State | Dropped;
