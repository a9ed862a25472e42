// Channels that are reckoned here from others: a script can ask for the difference of the pressures, which no sensor measures.

/**
 * @typedef {import("./live.js").Channel} Channel
 * @typedef {import("./live.js").Buckets} Buckets
 */

const DIFFERENCE = { name: "pressure_difference_bar", label: "pressure 1 − 2", unit: "bar", group: "difference", derived: true };

/** What is added to the channels of a stream. */
export class Derived {
  /** @param {Channel[]} received as `hello` names them */
  constructor(received) {
    const index = (/** @type {string} */ name) => received.findIndex((channel) => channel.name === name);
    this.first = index("pressure1_bar");
    this.second = index("pressure2_bar");
    const reference = index(`reference_${DIFFERENCE.name}`);
    this.reckoned = this.first >= 0 && this.second >= 0 && reference >= 0;
    /** With what is added at their end. @type {Channel[]} */
    this.channels = this.reckoned
      ? [...received.map((channel, i) => (i === reference ? { ...channel, group: DIFFERENCE.group } : channel)), DIFFERENCE]
      : received;
  }

  /**
   * Adds the columns. Of a difference only the last value is known: the extremes of a bucket need not have been at the same tick.
   * @param {Buckets} buckets
   * @returns {Buckets}
   */
  add(buckets) {
    if (!this.reckoned) return buckets;
    const [first, second] = [buckets.channels[this.first].last, buckets.channels[this.second].last];
    const last = first.map((value, row) => value - second[row]);
    return { ...buckets, channels: [...buckets.channels, { min: last, max: last, last }] };
  }
}
