// The plan: the site from above as SVG, with beacons, trail, pose, covariance and protection to scale.

import { cholesky, magnification, niceStep, RADIUS_95, rotation, size } from "./geometry";
import type { Health, Pose, Site, Vector } from "./protocol";
import type { Trail } from "./trail";
import { beaconSaid, length, STATUS } from "./words";

const SVG = "http://www.w3.org/2000/svg";

export interface Shown {
  trail: boolean;
  covariance: boolean;
  protection: boolean;
}

export interface ErrorMap {
  x_m: number[];
  y_m: number[];
  z_m: number;
  position_sd_m: (number | null)[][];
}

function svg(name: string, attributes: Record<string, string | number> = {}, parent?: Element): SVGElement {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  parent?.append(element);
  return element;
}

const path = (points: Vector[]): string => points.map(([x, y]) => `${x.toFixed(4)},${(-y).toFixed(4)}`).join(" ");

export class Plan {
  private readonly root: SVGElement;
  private readonly beacons = new Map<string, { mark: SVGElement; wire: SVGElement }>();
  private readonly layers: Record<"map" | "grid" | "wires" | "trail" | "marks" | "pose", SVGElement>;
  private readonly trailLine: SVGElement;
  private readonly letters: SVGElement[];
  private readonly sensor: Record<"x" | "y" | "z" | "dot" | "ellipse" | "protection", SVGElement>;
  private unit = 1;
  private whole = 1;
  private trailVersion = -1;

  constructor(private readonly host: HTMLElement) {
    this.root = svg("svg", { role: "img", "aria-label": "Plan of the site", class: "plan-svg" });
    const layer = (name: string): SVGElement => svg("g", { class: `layer-${name}` }, this.root);
    this.layers = {
      map: layer("map"), grid: layer("grid"), wires: layer("wires"), trail: layer("trail"),
      marks: layer("marks"), pose: layer("pose"),
    };
    this.trailLine = svg("polyline", { class: "trail" }, this.layers.trail);
    this.sensor = {
      protection: svg("circle", { class: "protection" }, this.layers.pose),
      ellipse: svg("circle", { class: "covariance", r: 1 }, this.layers.pose),
      z: svg("line", { class: "axis z" }, this.layers.pose),
      y: svg("line", { class: "axis y" }, this.layers.pose),
      x: svg("line", { class: "axis x" }, this.layers.pose),
      dot: svg("circle", { class: "dot" }, this.layers.pose),
    };
    this.letters = ["x", "y", "z"].map((name) => {
      const letter = svg("text", { class: `letter ${name}`, "text-anchor": "middle" }, this.layers.pose);
      letter.textContent = name;
      return letter;
    });
    this.host.append(this.root);
  }

  setSite(site: Site): void {
    const { low_m: low, high_m: high } = site.box;
    this.whole = size(low, high);
    const pad = 0.06 * this.whole;
    this.unit = 0.011 * this.whole;
    this.root.setAttribute(
      "viewBox",
      [low[0] - pad, -high[1] - pad, high[0] - low[0] + 2 * pad, high[1] - low[1] + 2 * pad].map((v) => v.toFixed(4)).join(" "),
    );
    this.drawGrid(low, high);
    this.drawBeacons(site);
    this.layers.map.replaceChildren();
    this.layers.pose.setAttribute("visibility", "hidden");
    this.trailVersion = -1;
  }

  private drawGrid(low: Vector, high: Vector): void {
    const group = this.layers.grid;
    group.replaceChildren();
    const step = niceStep(Math.max(high[0] - low[0], high[1] - low[1]), 6);
    const decimals = step < 1 ? Math.ceil(-Math.log10(step) - 1e-9) : 0;
    const text = (x: number, y: number, words: string, anchor: string): void => {
      svg("text", { x, y, "font-size": 2.4 * this.unit, "text-anchor": anchor, class: "tick" }, group).textContent = words;
    };
    for (let i = Math.ceil(low[0] / step); i * step <= high[0]; i++) {
      svg("line", { x1: i * step, x2: i * step, y1: -low[1], y2: -high[1], class: "grid" }, group);
      text(i * step, -low[1] + 3.4 * this.unit, (i * step).toFixed(decimals), "middle");
    }
    for (let i = Math.ceil(low[1] / step); i * step <= high[1]; i++) {
      svg("line", { x1: low[0], x2: high[0], y1: -i * step, y2: -i * step, class: "grid" }, group);
      text(low[0] - 1.2 * this.unit, -i * step + 0.8 * this.unit, (i * step).toFixed(decimals), "end");
    }
  }

  /** Draw the coils; the names of those above each other stand in one line. */
  private drawBeacons(site: Site): void {
    this.layers.wires.replaceChildren();
    this.layers.marks.replaceChildren();
    this.beacons.clear();
    const stacks = new Map<string, { at: Vector; names: string[]; top: number }>();
    for (const beacon of [...site.beacons].sort((a, b) => a.position_m[2] - b.position_m[2])) {
      const wire = svg("polyline", { points: path(beacon.wire_m), class: "wire" }, this.layers.wires);
      const key = beacon.position_m.slice(0, 2).map((v) => Math.round(v / (3 * this.unit))).join();
      const stack = stacks.get(key) ?? { at: beacon.position_m, names: [], top: -Infinity };
      stack.top = Math.max(stack.top, ...beacon.wire_m.map((point) => point[1]));
      const [x, y] = [stack.at[0] + 2.6 * this.unit * stack.names.length, -stack.at[1]];
      const mark = svg("text", { x, y: y + 0.9 * this.unit, "font-size": 2.6 * this.unit, class: "beacon-mark", "text-anchor": "middle" }, this.layers.marks);
      stack.names.push(beacon.id);
      stacks.set(key, stack);
      this.beacons.set(beacon.id, { mark, wire });
    }
    for (const { at, names, top } of stacks.values()) {
      svg("text", { x: at[0], y: -top - 1.2 * this.unit, "font-size": 2.6 * this.unit, class: "beacon-name", "text-anchor": "middle" }, this.layers.marks)
        .textContent = names.join(" ");
    }
    this.setHealth(null);
  }

  setHealth(health: Health | null): void {
    for (const [id, { mark, wire }] of this.beacons) {
      const said = beaconSaid(health?.beacons[id]);
      mark.textContent = said.mark;
      mark.setAttribute("data-tone", said.tone);
      wire.setAttribute("data-tone", said.tone);
    }
  }

  /** Draw a pose, and return what a note must say of how it is drawn. */
  setPose(pose: Pose, trail: Trail, shown: Shown): string {
    this.layers.trail.setAttribute("visibility", shown.trail ? "visible" : "hidden");
    if (shown.trail && trail.version !== this.trailVersion) {
      this.trailLine.setAttribute("points", path(trail.points));
      this.trailVersion = trail.version;
    }
    const at = pose.position_m;
    this.layers.pose.setAttribute("visibility", at ? "visible" : "hidden");
    if (!at || !pose.orientation_xyzw) {
      this.root.setAttribute("aria-label", "Plan of the site; there is no pose");
      return "";
    }
    const turned = rotation(pose.orientation_xyzw);
    const reach = 9 * this.unit;
    (["x", "y", "z"] as const).forEach((name, i) => {
      this.place(this.sensor[name], { x1: at[0], y1: -at[1], x2: at[0] + reach * turned[0][i], y2: -(at[1] + reach * turned[1][i]) });
      this.letters[i].setAttribute("font-size", String(2.6 * this.unit));
      this.place(this.letters[i], { x: at[0] + 1.25 * reach * turned[0][i], y: 0.9 * this.unit - (at[1] + 1.25 * reach * turned[1][i]) });
    });
    this.place(this.sensor.dot, { cx: at[0], cy: -at[1], r: 1.1 * this.unit });
    this.sensor.dot.setAttribute("data-tone", STATUS[pose.status]?.tone ?? "idle");
    this.root.setAttribute("aria-label", `Plan of the site; the sensor is at x ${at[0].toFixed(2)} m, y ${at[1].toFixed(2)} m, status ${pose.status}`);
    return [this.setCovariance(pose, at, shown.covariance), this.setProtection(pose, at, shown.protection)].filter(Boolean).join("; ");
  }

  private setCovariance(pose: Pose, at: Vector, shown: boolean): string {
    const l = shown && pose.position_cov_m2 ? cholesky(pose.position_cov_m2) : null;
    this.sensor.ellipse.setAttribute("visibility", l ? "inherit" : "hidden");
    if (!l) return "";
    const radius = RADIUS_95.plane * Math.hypot(l[0][0], l[1][0], l[1][1]);
    const larger = magnification(radius, this.whole);
    const k = RADIUS_95.plane * larger;
    this.sensor.ellipse.setAttribute("transform", `matrix(${k * l[0][0]} ${-k * l[1][0]} 0 ${k * l[1][1]} ${at[0]} ${-at[1]})`);
    return `ellipse: 95 % of the covariance${larger > 1 ? `, drawn ${larger} times larger` : ""}`;
  }

  private setProtection(pose: Pose, at: Vector, shown: boolean): string {
    const radius = shown ? pose.protection_m : null;
    this.sensor.protection.setAttribute("visibility", radius === null ? "hidden" : "inherit");
    if (radius === null) return shown ? "no protection radius" : "";
    this.place(this.sensor.protection, { cx: at[0], cy: -at[1], r: radius });
    return `dashed: protection, ${length(radius)}`;
  }

  private place(element: SVGElement, values: Record<string, number>): void {
    for (const [name, value] of Object.entries(values)) element.setAttribute(name, value.toFixed(5));
  }

  /** Draw the map of the expected error beneath the site, or none; return its legend. */
  setErrorMap(map: ErrorMap | null): string {
    this.layers.map.replaceChildren();
    if (!map) return "";
    const values = map.position_sd_m.flat().filter((v): v is number => v !== null).sort((a, b) => a - b);
    if (!values.length) return `nothing is to be expected at z = ${map.z_m} m`;
    const [least, most] = [values[0], values[Math.floor(0.95 * (values.length - 1))]];
    const canvas = document.createElement("canvas");
    canvas.width = map.x_m.length;
    canvas.height = map.y_m.length;
    const context = canvas.getContext("2d");
    if (!context) return "";
    const image = context.createImageData(canvas.width, canvas.height);
    map.position_sd_m.forEach((row, j) => row.forEach((value, i) => {
      const part = value === null ? 1 : Math.min(1, Math.log(value / least) / Math.max(1e-9, Math.log(most / least)));
      // From a calm blue-green to orange; the transparency grows with the certainty, so that good places are plain.
      image.data.set([40 + 190 * part, 150 - 30 * part, 160 - 120 * part, 40 + 120 * part], 4 * ((canvas.height - 1 - j) * canvas.width + i));
    }));
    context.putImageData(image, 0, 0);
    const step = map.x_m.length > 1 ? map.x_m[1] - map.x_m[0] : 1;
    svg("image", {
      href: canvas.toDataURL(), x: map.x_m[0] - step / 2, y: -(map.y_m.at(-1) ?? 0) - step / 2,
      width: step * canvas.width, height: step * canvas.height, preserveAspectRatio: "none",
    }, this.layers.map);
    return `expected error at z = ${map.z_m} m: ${length(least)} (blue) to ${length(most)} and more (orange)`;
  }
}
