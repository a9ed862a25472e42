// The newest values in large digits, each with its reference and with what its sensor says about itself.

import { byId, make, say } from "./dom.js";
import { NONE, number, unitText } from "./format.js";
import { REFERENCE } from "./theme.js";

/**
 * @typedef {import("./live.js").Channel} Channel
 * @typedef {import("./history.js").History} History
 */

/** Names of the sensors in `link`, by channel. What has none, the command, is neither valid nor old. */
const SENSORS = {
  angle_deg: "angle", pressure1_bar: "pressure1", pressure2_bar: "pressure2", torque_nm: "torque", volume_ml: "volume",
};
const ORDER = ["pressure1_bar", "pressure2_bar", "angle_deg", "torque_nm", "voltage_v", "volume_ml"];
/** The loop's period; what is older than two of them is said. */
const OLD_MS = 2;

/** The row of values. */
export class Readouts {
  constructor() {
    /** @type {{channel: number, reference: number, sensor: string|null, unit: string, tile: HTMLElement, value: HTMLElement, note: HTMLElement}[]} */
    this.tiles = [];
  }

  /** @param {Channel[]} channels */
  setChannels(channels) {
    this.tiles = ORDER.flatMap((name) => {
      const channel = channels.findIndex((c) => c.name === name);
      if (channel < 0) return [];
      const { label, unit } = channels[channel];
      const tile = make("div", "tile");
      tile.dataset.channel = name;
      const head = make("div", "tile-head");
      head.textContent = label;
      const value = make("b", "tile-value", NONE);
      const line = make("div", "tile-line");
      line.append(value, make("span", "tile-unit", unitText(unit)));
      const note = make("div", "tile-note faint");
      tile.append(head, line, note);
      const sensor = SENSORS[/** @type {keyof typeof SENSORS} */ (name)] ?? null;
      return [{ channel, reference: channels.findIndex((c) => c.name === REFERENCE + name), sensor, unit, tile, value, note }];
    });
    byId("tiles").replaceChildren(...this.tiles.map(({ tile }) => tile));
  }

  /**
   * @param {History|null} history
   * @param {any} link of the state; null before the first sample
   * @param {boolean} current the run is under way, so that its values are of now
   */
  draw(history, link, current) {
    for (const { channel, reference, sensor, unit, tile, value, note } of this.tiles) {
      const newest = history ? history.latest(channel) : NaN;
      say(value, number(newest, unit));
      const wanted = history && reference >= 0 ? history.latest(reference) : NaN;
      const parts = Number.isNaN(wanted) ? [] : [`ref ${number(wanted, unit)}`];
      let fault = "";
      if (sensor && link) {
        const age_ms = link.ages_ms?.[sensor] ?? null;
        const valid = link.valid?.[sensor] ?? false;
        // A quantity without a value is not measured in this run, which is no fault; one with a value that does not count is.
        if (age_ms === null) parts.push("not measured");
        else if (!valid) fault = "INVALID";
        else parts.push("valid", `${age_ms.toFixed(1)} ms old`);
        if (age_ms !== null && valid && age_ms > OLD_MS) fault = "OLD";
      } else if (!sensor) {
        parts.push("command");
      }
      tile.classList.toggle("fault", fault !== "" && current);
      say(note, [fault && current ? fault : "", ...parts].filter(Boolean).join(" · "));
    }
  }
}
