// The connection to the server: it opens again by itself, and a server that says nothing counts as gone.

import type { Message } from "./protocol";

const SILENCE_MS = 5000;
const FIRST_WAIT_MS = 400;
const LONGEST_WAIT_MS = 4000;

export class Connection {
  private socket: WebSocket | null = null;
  private waitMs = FIRST_WAIT_MS;
  private retry = 0;
  private watchdog = 0;

  constructor(
    private readonly take: (messages: Message[]) => void,
    private readonly gone: () => void,
  ) {
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => document.hidden || this.hurry());
    this.open();
  }

  private open(): void {
    clearTimeout(this.retry);
    const address = new URL("live", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this.socket = socket;
    this.listen(socket);
    socket.onmessage = (event) => {
      if (socket !== this.socket) return;
      this.waitMs = FIRST_WAIT_MS;
      this.listen(socket);
      this.take(JSON.parse(event.data as string) as Message[]);
    };
    socket.onclose = () => this.lose(socket);
  }

  /** Give up a socket on which nothing comes; a cable that was pulled closes none. */
  private listen(socket: WebSocket): void {
    clearTimeout(this.watchdog);
    this.watchdog = setTimeout(() => this.lose(socket), SILENCE_MS);
  }

  private lose(socket: WebSocket): void {
    if (socket !== this.socket) return;
    this.socket = null;
    clearTimeout(this.watchdog);
    socket.close();
    this.gone();
    this.retry = setTimeout(() => this.open(), this.waitMs);
    this.waitMs = Math.min(2 * this.waitMs, LONGEST_WAIT_MS);
  }

  /** Do not wait any longer: the network is back, or somebody looks again. */
  private hurry(): void {
    if (this.socket === null) this.open();
  }
}
