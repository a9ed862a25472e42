// The list of events, newest first.

import { byId, make } from "./dom.js";
import { clock } from "./format.js";

/** Older ones are in the recording. */
const KEPT = 300;
const SIGNS = { info: "i", warning: "▲", error: "✕" };

/** The list on the page. */
export class Events {
  constructor() {
    this.list = byId("events");
    /** Numbers that are shown: a reconnect brings the last ones again. @type {Set<string>} */
    this.known = new Set();
  }

  /** The service says from the start on what happened. */
  clear() {
    this.known.clear();
    this.list.replaceChildren(make("li", "faint none", "none yet"));
  }

  /** @param {{number?: number, utc: string, severity: "info"|"warning"|"error", source: string, text: string, run: number|null, time_s: number|null}} event */
  add(event) {
    const key = String(event.number ?? `${event.utc} ${event.text}`);
    if (this.known.has(key)) return;
    this.known.add(key);
    this.list.querySelector(".none")?.remove();
    const item = make("li", `event ${event.severity}`);
    const sign = make("span", "sign", SIGNS[event.severity] ?? "?");
    sign.setAttribute("role", "img");
    sign.setAttribute("aria-label", event.severity);
    const when = make("time", "faint", clock(event.utc));
    when.setAttribute("datetime", event.utc);
    const place = event.run === null || event.run === undefined ? "" : `run ${event.run}${event.time_s === null ? "" : ` at ${event.time_s.toFixed(3)} s`} · `;
    const text = make("span", "text", event.text);
    const source = make("span", "faint", ` ${place}${event.source}`);
    text.append(source);
    item.append(sign, when, text);
    this.list.prepend(item);
    while (this.list.children.length > KEPT) this.list.lastElementChild?.remove();
  }
}
