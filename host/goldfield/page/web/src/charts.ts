// Time series of the latest minutes. What is older than the longest span goes, and each chart is drawn four times a second.

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { colour, make, setText } from "./dom";
import type { Epoch, Health } from "./protocol";
import { figure } from "./words";

const LONGEST_S = 600;
const MOST = 24_000;
const DRAW_EVERY_MS = 250;

interface Line {
  label: string;
  colour: string;
  value: (epoch: Epoch, health: Health | null) => number | null;
}

interface Kind {
  title: string;
  unit: string;
  decimals: number;
  lines: Line[];
}

const KINDS: Kind[] = [
  { title: "Residual", unit: "1 = as expected", decimals: 2, lines: [
    { label: "pose", colour: "accent", value: (epoch) => epoch.residual },
    { label: "worst beacon", colour: "second", value: (epoch) => worst(epoch) },
  ] },
  { title: "Noise of a field", unit: "nT", decimals: 2, lines: [
    { label: "standard deviation", colour: "accent", value: (epoch) => (epoch.noise_T === null ? null : 1e9 * epoch.noise_T) },
  ] },
  { title: "Rates", unit: "per second", decimals: 1, lines: [
    { label: "cycles", colour: "accent", value: (_, health) => health?.cycles_per_s ?? null },
    { label: "messages lost", colour: "second", value: (_, health) => (health ? health.lost / 2 : null) },
  ] },
];

function worst(epoch: Epoch): number | null {
  const values = Object.values(epoch.beacons).filter((value): value is number => value !== null);
  return values.length ? Math.max(...values) : null;
}

class Chart {
  private plot: uPlot | null = null;
  private readonly picture = make("div", { class: "chart-picture", role: "img" });
  private readonly latest = make("span", { class: "latest" }, "–");
  private width = 0;

  constructor(private readonly kind: Kind, host: HTMLElement) {
    const keys = kind.lines.map((line, i) => make("span", { class: `key key-${i}` }, line.label));
    host.append(make("figure", { class: "chart" }, make("figcaption", {}, make("strong", {}, kind.title), ` ${kind.unit} `, this.latest, make("span", { class: "keys" }, ...keys)), this.picture));
    new ResizeObserver(() => this.resize()).observe(this.picture);
  }

  build(): void {
    this.plot?.destroy();
    const line = { stroke: colour("muted"), grid: { stroke: colour("rule"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    const series = this.kind.lines.map((one, i) => ({ label: one.label, stroke: colour(one.colour), width: 1.5, dash: i ? [5, 3] : [], points: { show: false } }));
    this.plot = new uPlot(
      {
        width: Math.max(100, this.picture.clientWidth), height: Math.max(80, this.picture.clientHeight),
        legend: { show: false }, cursor: { show: false },
        scales: { x: { time: false }, y: { range: (_, low, high) => [Math.min(0, low ?? 0), 1.1 * Math.max(high ?? 1, 1e-6)] } },
        axes: [{ ...line, size: 26, values: (_, ticks) => ticks.map((t) => `${t} s`) }, { ...line, size: 40 }],
        series: [{}, ...series],
      },
      [[], ...this.kind.lines.map(() => [])] as uPlot.AlignedData,
      this.picture,
    );
  }

  private resize(): void {
    const width = this.picture.clientWidth;
    if (width === this.width || !width) return;
    this.width = width;
    this.plot?.setSize({ width, height: this.picture.clientHeight });
  }

  draw(times: number[], columns: (number | null)[][], span: number): void {
    const end = times.at(-1) ?? 0;
    let start = 0;
    while (times[start] < end - span) start++;
    const shown = columns.map((column) => column.slice(start));
    // Axes without a line would have labels of nothing.
    this.picture.dataset.empty = String(!shown.flat().some((value) => value !== null));
    if (times.length) {
      this.plot?.setData([times.slice(start), ...shown] as uPlot.AlignedData, false);
      this.plot?.setScale("x", { min: Math.max(end - span, Math.min(times[0], end - 1)), max: end });
    }
    const said = columns.map((column) => figure(column.at(-1), this.kind.decimals));
    setText(this.latest, said.join(" / "));
    this.picture.setAttribute("aria-label", `${this.kind.title}, ${this.kind.unit}: ${this.kind.lines.map((one, i) => `${one.label} ${said[i]}`).join(", ")}`);
  }
}

export class Charts {
  private times: number[] = [];
  private columns: (number | null)[][][] = KINDS.map((kind) => kind.lines.map(() => []));
  private readonly charts: Chart[];
  private due = 0;
  span = 120;

  constructor(host: HTMLElement) {
    this.charts = KINDS.map((kind) => new Chart(kind, host));
    this.paint();
  }

  paint(): void {
    this.charts.forEach((chart) => chart.build());
    this.draw();
  }

  clear(): void {
    this.times = [];
    this.columns = KINDS.map((kind) => kind.lines.map(() => []));
  }

  add(epoch: Epoch, health: Health | null): void {
    if (epoch.t_s === null) return;
    if (this.times.length && epoch.t_s <= this.times[this.times.length - 1]) this.clear(); // the sensor's clock began again
    this.times.push(epoch.t_s);
    KINDS.forEach((kind, k) => kind.lines.forEach((line, i) => this.columns[k][i].push(line.value(epoch, health))));
    const old = this.times.findIndex((time) => time >= (epoch.t_s as number) - LONGEST_S);
    if (old > 1000 || this.times.length > MOST) {
      const cut = Math.max(old, this.times.length - MOST + 1000);
      this.times.splice(0, cut);
      this.columns.flat().forEach((column) => column.splice(0, cut));
    }
  }

  /** Draw soon; the calls meanwhile cost nothing. */
  show(): void {
    if (this.due) return;
    this.due = setTimeout(() => {
      this.due = 0;
      this.draw();
    }, DRAW_EVERY_MS);
  }

  draw(): void {
    this.charts.forEach((chart, k) => chart.draw(this.times, this.columns[k], this.span));
  }
}
