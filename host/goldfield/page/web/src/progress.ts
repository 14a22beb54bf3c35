// How far a survey or a calibration is: a sentence, a bar for the whole, and a line with a bar for each part.

import { byId, make, setText } from "./dom";
import type { Progress } from "./protocol";

const TITLES: Record<string, string> = { survey: "Survey", calibration: "Calibration of the sensor" };

export class ProgressCard {
  private readonly rows = new Map<string, { text: HTMLElement; bar: HTMLProgressElement }>();

  clear(): void {
    byId("progress").hidden = true;
    this.rows.clear();
    byId("progress-rows").replaceChildren();
  }

  set(progress: Progress): void {
    byId("progress").hidden = false;
    setText(byId("progress-title"), TITLES[progress.task] ?? progress.task);
    setText(byId("progress-text"), progress.text);
    setBar(byId<HTMLProgressElement>("progress-share"), progress.share);
    for (const row of progress.rows) {
      const shown = this.rows.get(row.name) ?? this.addRow(row.name);
      setText(shown.text, row.text);
      setBar(shown.bar, row.share);
    }
  }

  private addRow(name: string): { text: HTMLElement; bar: HTMLProgressElement } {
    const row = { text: make("span", { class: "number" }), bar: make("progress", { max: "1", "aria-label": `How far ${name} is` }) };
    byId("progress-rows").append(make("li", {}, make("strong", {}, name), row.text, row.bar));
    this.rows.set(name, row);
    return row;
  }
}

/** A bar of which nobody knows how far it is would move for ever: it is left out. */
function setBar(bar: HTMLProgressElement, share: number | null): void {
  bar.hidden = share === null;
  if (share !== null) bar.value = share;
}
