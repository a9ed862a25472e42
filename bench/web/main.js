// The monitor: takes what the service sends and has it drawn, at most once a frame and not at all in a hidden tab.

import { Api } from "./api.js";
import { Controls } from "./controls.js";
import { Derived } from "./derived.js";
import { byId, say } from "./dom.js";
import { Events } from "./events.js";
import { Histogram } from "./histogram.js";
import { History } from "./history.js";
import { Live } from "./live.js";
import { PhasePlots } from "./phase.js";
import { TimePlots } from "./plots.js";
import { Readouts } from "./readouts.js";
import { Runs } from "./runs.js";
import { Status } from "./status.js";
import { EmergencyStop } from "./stop.js";
import { onThemeChange } from "./theme.js";

/** The loop's period. */
const TICK_S = 1e-3;
/** Digits that change faster can't be read. */
const SLOW_MS = 100;

const api = new Api();
const status = new Status();
const plots = new TimePlots();
const phase = new PhasePlots();
const histogram = new Histogram();
const readouts = new Readouts();
const controls = new Controls(api);
const emergencyStop = new EmergencyStop(api);
const events = new Events();
const runs = new Runs(api);

/** @type {History|null} */
let history = null;
/** Which run the history is of. @type {{run: number, origin: number|null}|null} */
let shown = null;
let channelKey = "";
let derived = new Derived([]);
let bucket_s = 0.01;
/** @type {number|null} */
let window_s = 10;
let paused = false;
/** @type {any} */
let state = null;
/** The newest message of this kind: it may come before the run that it is of. @type {any} */
let timing = null;
let scheduled = false;
let dirty = false;
let phaseDirty = false;
/** From when the newest sample was due to when it was drawn, ms: what the tests read. @type {number[]} */
const delays_ms = [];

/** A frame is drawn when there is something new to see and somebody to see it. */
function schedule() {
  dirty = true;
  if (scheduled || document.hidden) return;
  scheduled = true;
  requestAnimationFrame(draw);
}

function draw() {
  scheduled = false;
  dirty = false;
  if (!history || paused) return;
  plots.draw(history, window_s);
  phaseDirty = true;
  measureDelay(history);
}

/** Digits and phase plots, at a pace that can be followed. */
function drawSlowly() {
  if (dirty) schedule();
  readouts.draw(history, state?.link ?? null, state?.run ? !state.run.ended : false);
  status.setDelay(median(delays_ms));
  if (phaseDirty && history) phase.draw(plots.view, history.seen);
  phaseDirty = false;
}
setInterval(() => !document.hidden && requestAnimationFrame(drawSlowly), SLOW_MS);

let measured = -1;
/** A message that a frame sends itself arrives once it has been painted. */
const painted = new MessageChannel();
painted.port1.onmessage = (/** @type {MessageEvent<number>} */ message) => {
  const delay_ms = Date.now() - message.data;
  // Beyond that it is another machine's clock, not a delay.
  if (delay_ms < 0 || delay_ms > 10_000) delays_ms.length = 0;
  else delays_ms.push(delay_ms);
  if (delays_ms.length > 250) delays_ms.shift();
};

/** @param {History} of */
function measureDelay(of) {
  if (of.newest === measured || typeof shown?.origin !== "number") return;
  measured = of.newest;
  // The newest sample of the newest bucket.
  painted.port2.postMessage(shown.origin + (of.end_s - TICK_S) * 1000);
}

/** @param {number[]} values */
function median(values) {
  return values.length ? [...values].sort((a, b) => a - b)[values.length >> 1] : null;
}

/** Starts afresh for a run, unless it is the one that is shown: after a reconnect its history goes on. @param {number} run @param {number|null} origin */
function begin(run, origin) {
  const same = shown?.run === run && (origin === shown.origin || (origin !== null && shown.origin !== null && Math.abs(origin - shown.origin) < 1000));
  if (same && history) return;
  shown = { run, origin };
  history = new History(derived.channels.length, bucket_s);
  measured = -1;
  delays_ms.length = 0;
  histogram.set(timing?.run === run ? timing : null);
  schedule();
}

new Live(api.live, {
  hello(hello) {
    bucket_s = hello.ticks_per_bucket * TICK_S;
    const key = JSON.stringify(hello.channels);
    if (key !== channelKey) {
      channelKey = key;
      derived = new Derived(hello.channels);
      history = null;
      shown = null;
      plots.setChannels(derived.channels);
      phase.setChannels(derived.channels);
      readouts.setChannels(derived.channels);
    }
    events.clear();
  },
  state(next) {
    state = next;
    status.set(next);
    controls.set(next);
    emergencyStop.set(next);
    runs.set(next);
  },
  begin: ({ run, origin_utc_ms }) => begin(run, origin_utc_ms ?? null),
  buckets(frame) {
    if (!history || shown?.run !== frame.run) begin(frame.run, null);
    history?.append(derived.add(frame));
    schedule();
  },
  event: (event) => events.add(event),
  timing(next) {
    timing = next;
    if (timing.run === shown?.run) histogram.set(timing);
  },
  connected(connected) {
    status.setConnected(connected);
    controls.setConnected(connected);
  },
  broken(error) {
    console.error(error);
    events.add({ utc: new Date().toISOString(), severity: "error", source: "this page", text: `a message of the service can't be read: ${error}`, run: null, time_s: null });
  },
});

document.addEventListener("visibilitychange", schedule);
onThemeChange(() => {
  plots.rebuild();
  phase.rebuild();
  histogram.rebuild();
  schedule();
});

for (const button of byId("windows").querySelectorAll("button")) {
  button.onclick = () => {
    window_s = button.dataset.window === "all" ? null : Number(button.dataset.window);
    for (const other of byId("windows").querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === button));
    if (paused) pause(false);
    schedule();
  };
}

/** @param {boolean} on */
function pause(on) {
  paused = on;
  byId("pause").setAttribute("aria-pressed", String(on));
  say(byId("pause"), on ? "Paused: go on" : "Pause");
  document.body.classList.toggle("paused", on);
  schedule();
}
byId("pause").onclick = () => pause(!paused);

// For tests and for the curious: what is drawn, as data.
Object.assign(globalThis, { recBench: { plots, delays_ms, get history() { return history; } } });
