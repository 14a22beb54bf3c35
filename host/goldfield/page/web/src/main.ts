// The page: takes the server's messages, and shows the latest of them with every picture that the browser draws.

import "./style.css";
import { Alarms } from "./alarms";
import { Charts } from "./charts";
import { Connection } from "./connection";
import { byId, make, setChip, setText } from "./dom";
import { showFigures } from "./figures";
import { Plan, type ErrorMap } from "./plan";
import { ProgressCard } from "./progress";
import { PROTOCOL, type Epoch, type Health, type Message, type Pose, type Site, type State } from "./protocol";
import type { Space } from "./space";
import { Tables } from "./tables";
import { Trail } from "./trail";
import { LINK, STATUS } from "./words";

/** What the states of a stream are called if it is a recording. */
const RECORDED: Partial<Record<State["state"], string>> = { running: "playing", ended: "played" };

/** How long a page without a pose waits before it draws three dimensions. */
const WITHOUT_POSE_MS = 1000;

const announce = (text: string): void => setText(byId("announce"), text);
const ticked = (id: string): boolean => byId<HTMLInputElement>(id).checked;

const trail = new Trail();
const plan = new Plan(byId("plan"));
const tables = new Tables(byId("beacons"), byId("boards"));
const charts = new Charts(byId("charts"));
const progress = new ProgressCard();
const alarms = new Alarms(announce);

let space: Space | null = null;
let spaceOpens = false;
let site: Site | null = null;
let pose: Pose | null = null;
let health: Health | null = null;
let live = true;
let ended = false;
let held = false;
let epochs = 0;
let dropped = 0;
let changed = false;
let drawing = false;
let mapHeight: number | null = null;
let mapLegend = "";

/** Three dimensions take most of the page's bytes and time to start: they come behind the first pose, or if there is none. */
function openSpaceIn(milliseconds: number): void {
  if (spaceOpens) return;
  setTimeout(() => {
    if (!spaceOpens) void openSpace();
    spaceOpens = true;
  }, milliseconds);
}

async function openSpace(): Promise<void> {
  const pictures = await import("./space").catch(() => null);
  try {
    if (!pictures) throw new Error("not loaded");
    space = new pictures.Space(byId("space"));
  } catch {
    const why = pictures ? "This browser draws no three dimensions (WebGL is off)" : "The server did not answer when three dimensions were to be loaded: load the page again";
    byId("space").append(make("p", { class: "note" }, `${why}; the plan shows the same.`));
    return;
  }
  if (site) space.setSite(site);
  if (health) space.setHealth(health);
  redraw();
}

function take(messages: Message[]): void {
  for (const message of messages) takeOne(message);
  if (!drawing && !held) {
    drawing = true;
    requestAnimationFrame(draw);
  }
}

function takeOne(message: Message): void {
  if (message.type === "hello") {
    if (message.protocol !== PROTOCOL) {
      setText(byId("link-text"), "The server is of another version than this page: load the page again.");
    }
    live = message.live;
    pose = health = null;
    epochs = dropped = 0; // the latest epochs come again
    trail.clear();
    charts.clear();
    progress.clear();
    site = message.site;
    plan.setSite(message.site);
    space?.setSite(message.site);
    tables.setSite(message.site);
    setText(byId("site-name"), message.site.name);
    setText(byId("source"), message.source);
    document.title = `${message.site.name} · goldfield`;
    mapHeight = null;
    openSpaceIn(WITHOUT_POSE_MS);
  } else if (message.type === "epoch") {
    takeEpoch(message);
  } else if (message.type === "fix") {
    takePose(message);
  } else if (message.type === "health") {
    health = message;
    changed = true;
  } else if (message.type === "progress") {
    progress.set(message);
  } else if (message.type === "state") {
    takeState(message);
  } else {
    dropped += message.count;
  }
}

function takeEpoch(epoch: Epoch): void {
  epochs++;
  if (!epoch.at_rate || pose === null) takePose(epoch);
  charts.add(epoch, health);
  alarms.take(epoch.alarms);
}

function takePose(next: Pose): void {
  pose = next;
  if (next.position_m) trail.add(next.position_m);
}

function takeState(state: State): void {
  alarms.draw(state.state === "running"); // before the link's word, which is the one to be read out
  ended = state.state === "ended";
  const said = LINK[live ? state.state : (RECORDED[state.state] ?? state.state)];
  if (byId("link-word").textContent !== said.word) announce(`${said.word}. ${state.text}`);
  setChip("link", said);
  const old = state.state === "silent" || state.state === "lost" ? ` The latest pose is ${Math.round(state.silent_s)} s old.` : "";
  setText(byId("link-text"), `${sentence(state.text)}${old}`);
  setAge(state.state !== "running");
}

function gone(): void {
  // Who was told of the end needs no alarm, and what was said last still holds.
  if (!ended) {
    setChip("link", LINK.gone);
    setText(byId("link-text"), "The server of this page does not answer: is goldfield still running? Trying again.");
  }
  setAge(true);
  alarms.draw(false);
}

/** What is not of now keeps its words, but loses the colours of what is. */
function setAge(old: boolean): void {
  document.body.dataset.old = String(old);
  setText(byId("pose-age"), old && pose ? "the latest one, not of now" : " ");
}

function sentence(text: string): string {
  return text ? `${text.charAt(0).toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}` : "";
}

function draw(): void {
  drawing = false;
  setText(byId("counts"), `${epochs} epochs${dropped ? `, ${dropped} messages skipped because this browser was slow` : ""}`);
  if (health && changed) {
    changed = false;
    tables.setHealth(health);
    plan.setHealth(health);
    space?.setHealth(health);
  }
  charts.show();
  if (!pose) return;
  const status = STATUS[pose.status] ?? { tone: "idle" as const, mark: "○", word: pose.status, meaning: "", advice: "" };
  setChip("status", status);
  setText(byId("status-text"), status.meaning);
  showFigures(pose);
  drawPictures(pose);
  openSpaceIn(0);
  void followError(pose);
}

function drawPictures(now: Pose): void {
  const shown = { trail: ticked("show-trail"), covariance: ticked("show-covariance"), protection: ticked("show-protection") };
  const notes = [plan.setPose(now, trail, shown), mapLegend];
  setText(byId("plan-note"), notes.filter(Boolean).join("; ") || " ");
  setText(byId("space-note"), space?.setPose(now, trail, shown) || " ");
}

/** Show the expected error at the sensor's height, to a tenth of a metre, if it is asked for. */
async function followError(now: Pose): Promise<void> {
  const wanted = ticked("show-error") && now.position_m ? Math.round(now.position_m[2] * 10) / 10 : null;
  if (wanted === mapHeight) return;
  mapHeight = wanted;
  if (wanted === null) {
    mapLegend = plan.setErrorMap(null);
    return;
  }
  mapLegend = "the expected error is being computed";
  const answer = await fetch(`expected_error?z=${wanted}`).catch(() => null);
  if (mapHeight !== wanted) return;
  if (!answer) mapLegend = "the server does not answer";
  else mapLegend = answer.ok ? plan.setErrorMap((await answer.json()) as ErrorMap) : await answer.text();
}

function redraw(): void {
  if (pose) draw();
}

for (const id of ["show-trail", "show-covariance", "show-protection", "show-error"]) byId(id).addEventListener("change", redraw);
byId("clear-trail").addEventListener("click", () => {
  trail.clear();
  redraw();
});
byId("hold").addEventListener("click", () => {
  held = !held;
  byId("hold").setAttribute("aria-pressed", String(held));
  announce(held ? "The page is held." : "The page goes on.");
});
byId<HTMLSelectElement>("span").addEventListener("change", (event) => {
  charts.span = Number((event.target as HTMLSelectElement).value);
  charts.draw();
});
for (const button of document.querySelectorAll<HTMLButtonElement>("[data-view]")) {
  button.addEventListener("click", () => space?.look(button.dataset.view ?? "oblique"));
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  charts.paint();
  space?.paint();
  redraw();
});

new Connection(take, gone);
