// The tables of beacons and boards. Rows are made once; then only the texts that change are set.

import { make, setText } from "./dom";
import type { BeaconHealth, Board, Health, Site } from "./protocol";
import { beaconSaid, figure, type Said } from "./words";

interface Column<T> {
  title: string;
  text: (item: T) => string;
  numeric: boolean;
}

class Table<T> {
  private readonly rows = new Map<string, HTMLTableCellElement[]>();
  private readonly body = make("tbody");

  constructor(table: HTMLElement, caption: string, first: string, private readonly columns: Column<T>[], private readonly said: (item: T) => Said) {
    const cells = [first, "State", ...columns.map((column) => column.title)].map((title, i) => {
      const numeric = i > 1 && columns[i - 2].numeric;
      return make("th", { scope: "col", ...(numeric ? { class: "number" } : {}) }, title);
    });
    table.append(make("caption", { class: "unseen" }, caption), make("thead", {}, make("tr", {}, ...cells)), this.body);
  }

  clear(): void {
    this.rows.clear();
    this.body.replaceChildren();
  }

  set(name: string, item: T): void {
    const cells = this.rows.get(name) ?? this.addRow(name);
    const said = this.said(item);
    cells[0].dataset.tone = said.tone;
    setText(cells[0], `${said.mark} ${said.word}`);
    this.columns.forEach((column, i) => setText(cells[i + 1], column.text(item)));
  }

  private addRow(name: string): HTMLTableCellElement[] {
    const cells = [make("td", { class: "state" }), ...this.columns.map((column) => make("td", column.numeric ? { class: "number" } : {}))];
    this.body.append(make("tr", {}, make("th", { scope: "row" }, name), ...cells));
    this.rows.set(name, cells);
    return cells;
  }
}

interface BeaconRow {
  beacon: BeaconHealth | undefined;
  board: Board | undefined;
}

const total = (counters: Record<string, number>): number => Object.values(counters).reduce((sum, count) => sum + count, 0);

const BEACON_COLUMNS: Column<BeaconRow>[] = [
  { title: "Measured nT", numeric: true, text: ({ beacon }) => figure(beacon?.measured_T, 0, 1e9) },
  { title: "Expected nT", numeric: true, text: ({ beacon }) => figure(beacon?.expected_T, 0, 1e9) },
  { title: "Ratio", numeric: true, text: ({ beacon }) => figure(beacon?.ratio, 3) },
  { title: "Residual", numeric: true, text: ({ beacon }) => figure(beacon?.residual, 2) },
  { title: "Current A", numeric: true, text: ({ beacon }) => figure(beacon?.current_A, 3) },
  { title: "Coil °C", numeric: true, text: ({ board }) => figure(board?.coil_degC, 1) },
  { title: "Driver °C", numeric: true, text: ({ board }) => figure(board?.driver_degC, 1) },
  { title: "Node", numeric: true, text: ({ beacon }) => figure(beacon?.node, 0) },
  { title: "Counted", numeric: true, text: ({ board }) => (board ? String(total(board.counters)) : "–") },
];

const BOARD_COLUMNS: Column<Board>[] = [
  { title: "Role", numeric: false, text: (board) => board.role ?? "–" },
  { title: "Firmware", numeric: false, text: (board) => board.version ?? "–" },
  { title: "Clock", numeric: false, text: (board) => (board.locked === null ? "–" : board.locked ? "locked" : "not locked") },
  { title: "Phase ns", numeric: true, text: (board) => figure(board.phase_s, 0, 1e9) },
  { title: "Chip °C", numeric: true, text: (board) => figure(board.temperature_degC, 1) },
  { title: "Supply V", numeric: true, text: (board) => figure(board.supply_V, 2) },
  { title: "Counted since reset", numeric: false, text: (board) => Object.entries(board.counters).map(([name, count]) => `${count} ${name}`).join(", ") || "nothing" },
];

function boardSaid(board: Board): Said {
  if (board.complaints.length) return { tone: "bad", mark: "✗", word: board.complaints.join(", ") };
  if (board.locked === false) return { tone: "warn", mark: "!", word: "clock not locked" };
  return { tone: "good", mark: "●", word: board.state ?? "heard" };
}

export class Tables {
  private readonly beacons: Table<BeaconRow>;
  private readonly boards: Table<Board>;
  private ids: string[] = [];

  constructor(beacons: HTMLElement, boards: HTMLElement) {
    this.beacons = new Table(beacons, "Beacons: strength against the expected one, residual, current, temperatures", "Beacon", BEACON_COLUMNS, ({ beacon }) => beaconSaid(beacon));
    this.boards = new Table(boards, "Boards on the link: role, firmware, clock, temperature, counters", "Node", BOARD_COLUMNS, boardSaid);
  }

  setSite(site: Site): void {
    this.ids = site.beacons.map((beacon) => beacon.id);
    this.beacons.clear();
    this.boards.clear();
    this.ids.forEach((id) => this.beacons.set(id, { beacon: undefined, board: undefined }));
  }

  setHealth(health: Health): void {
    for (const id of this.ids) {
      const beacon = health.beacons[id];
      this.beacons.set(id, { beacon, board: beacon?.node == null ? undefined : health.boards[beacon.node] });
    }
    Object.entries(health.boards).forEach(([number, board]) => this.boards.set(number, board));
  }
}
