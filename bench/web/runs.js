// Finished runs with their pages and recordings.

import { byId, make, say, show } from "./dom.js";
import { day, duration } from "./format.js";

const FIRST = 12;
/** Runs of other programs end in this folder, too. */
const AGAIN_MS = 30_000;

/** The table on the page. */
export class Runs {
  /** @param {import("./api.js").Api} api */
  constructor(api) {
    this.api = api;
    this.all = false;
    this.last = "";
    /** @type {any[]} */
    this.runs = [];
    byId("more-runs").onclick = () => {
      this.all = !this.all;
      this.draw();
    };
    setInterval(() => !document.hidden && this.load(), AGAIN_MS);
  }

  /** @param {any} state looked at for a run that has ended since */
  set(state) {
    const last = `${state.service.started_utc} ${state.last?.id ?? ""} ${state.run?.number ?? ""} ${state.run?.ended ?? ""}`;
    if (last === this.last) return;
    this.last = last;
    this.load();
  }

  /** @private */
  async load() {
    try {
      this.runs = await this.api.get("runs");
      this.draw();
    } catch {
      // The connection's banner says it; the next state or the next half minute asks again.
      this.last = "";
    }
  }

  /** @private */
  draw() {
    const shown = this.all ? this.runs : this.runs.slice(0, FIRST);
    show(byId("more-runs"), this.runs.length > FIRST);
    say(byId("more-runs"), this.all ? "fewer" : `all ${this.runs.length}`);
    if (shown.length === 0) {
      const cell = make("td", "faint", "none yet");
      cell.setAttribute("colspan", "6");
      const row = make("tr");
      row.append(cell);
      byId("runs").replaceChildren(row);
      return;
    }
    byId("runs").replaceChildren(...shown.map((run) => {
      const row = make("tr");
      const files = make("td");
      files.append(link(run.page, "page"), " · ", link(run.recording, ".mcap"));
      const good = run.outcome === "completed";
      row.append(
        make("td", "name", run.name),
        make("td", "", day(run.utc)),
        make("td", "number", duration(run.duration_s)),
        make("td", good ? "good" : run.outcome === "stopped" ? "" : "bad", `${good ? "✓" : run.outcome === "stopped" ? "□" : "✕"} ${run.outcome}`),
        make("td", run.lossless ? "" : "bad", run.lossless ? run.samples : `${run.samples}: lost`),
        files,
      );
      return row;
    }));
  }
}

/** @param {string} address @param {string} text */
function link(address, text) {
  const anchor = make("a", "", text);
  anchor.setAttribute("href", address);
  if (text === ".mcap") anchor.setAttribute("download", "");
  return anchor;
}
