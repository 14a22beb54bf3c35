// Alarms in words with what to do. An alarm stays for a few seconds after its last epoch, so that a list can be read.

import { byId, make, setText } from "./dom";
import type { Alarm } from "./protocol";
import { STATUS } from "./words";

const STAYS_MS = 3000;
const MOST_EARLIER = 30;

interface Kept {
  alarm: Alarm;
  first: Date;
  /** On the browser's own clock, which nobody sets. */
  last: number;
  count: number;
}

export class Alarms {
  private readonly now = new Map<string, Kept>();
  private earlier: Kept[] = [];
  private shown = "";

  constructor(private readonly announce: (text: string) => void) {
    this.draw(false);
  }

  take(alarms: Alarm[]): void {
    const time = performance.now();
    for (const alarm of alarms) {
      // One kind about one beacon is one alarm, in whatever words; of others the numbers change from epoch to epoch.
      const key = `${alarm.kind} ${alarm.beacons.join() || alarm.text.replace(/[\d.]+/g, "#")}`;
      const kept = this.now.get(key) ?? { alarm, first: new Date(), last: time, count: 0 };
      this.now.set(key, { ...kept, alarm, last: time, count: kept.count + 1 });
    }
  }

  /** Draw what is wrong now; alarms that are over go to the earlier ones. If nothing comes in, nothing is known. */
  draw(running: boolean): void {
    const time = performance.now();
    for (const [key, kept] of this.now) {
      if (time - kept.last < STAYS_MS) continue;
      this.now.delete(key);
      this.earlier = [kept, ...this.earlier].slice(0, MOST_EARLIER);
    }
    const state = `${running}|${[...this.now.keys()].join("|")}|${this.earlier.length}|${this.earlier[0]?.last ?? ""}`;
    if (state === this.shown) return;
    this.shown = state;
    const list = byId("alarms");
    setText(byId("alarm-count"), this.now.size ? `${this.now.size} now` : " ");
    const calm = running ? "Nothing is wrong." : "Nothing is known: no epoch comes in.";
    if (this.now.size) list.replaceChildren(...[...this.now.values()].map((kept) => this.item(kept)));
    else list.replaceChildren(make("li", { class: "calm", "data-tone": running ? "good" : "idle" }, make("span", { class: "mark", "aria-hidden": "true" }, running ? "✓" : "○"), ` ${calm}`));
    byId("earlier").replaceChildren(...this.earlier.map((kept) => this.item(kept)));
    setText(byId("earlier-count"), String(this.earlier.length));
    if (running) this.announce([...this.now.values()].map((kept) => kept.alarm.text).join(" ") || calm);
  }

  private item({ alarm, first, count }: Kept): HTMLLIElement {
    const status = STATUS[alarm.kind];
    const note = alarm.kind === "note";
    const tone = note || status?.tone === "warn" ? "warn" : "bad";
    const parts: (Node | string)[] = [make("span", { class: "mark", "data-tone": tone, "aria-hidden": "true" }, tone === "warn" ? "!" : "✗"), " ", make("strong", {}, `${sentence(alarm.text)} `)];
    if (status?.advice) parts.push(make("span", { class: "advice" }, status.advice), " ");
    parts.push(make("small", {}, `since ${first.toLocaleTimeString()}${count > 1 ? `, ${count} times` : ""}`));
    return make("li", { "data-tone": tone }, ...parts);
  }
}

function sentence(text: string): string {
  // A name with a figure in it, such as b3, is a beacon's, and stays as it is.
  const whole = /^\S*\d/.test(text) ? text : text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
