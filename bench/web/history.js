// What has been received of the current run, in arrays of fixed size: the last 80 s bucket by bucket, and the whole run in coarser ones.
//
// Everything is kept by the number of its slot, which is a span of the run's time. A slot that nothing came for stays empty and is drawn as a gap;
// merging keeps the least and the greatest value, so a spike of one sample survives every merge.

/** @typedef {import("./live.js").Buckets} Buckets */
/** @typedef {{min: Float32Array, max: Float32Array, last: Float32Array}} Column */

const CAPACITY = 8192;
const EMPTY = -1;

/** Slots of one span in a ring. */
export class Level {
  /**
   * @param {number} channelCount
   * @param {number} span buckets in a slot
   */
  constructor(channelCount, span = 1, capacity = CAPACITY) {
    this.span = span;
    this.capacity = capacity;
    /** The slot that lies at each place of the ring. */
    this.slots = new Float64Array(capacity).fill(EMPTY);
    /** @type {Column[]} */
    this.columns = Array.from({ length: channelCount }, () => ({
      min: new Float32Array(capacity), max: new Float32Array(capacity), last: new Float32Array(capacity),
    }));
  }

  /**
   * Where a slot lies; -1 where it is empty or overwritten.
   * @param {number} slot
   */
  place(slot) {
    const place = slot % this.capacity;
    return slot >= 0 && this.slots[place] === slot ? place : -1;
  }

  /**
   * Puts row `row` of `columns` into the slot of this bucket, beside what is there.
   * @param {number} bucket
   * @param {Column[]} columns
   * @param {number} row
   */
  put(bucket, columns, row) {
    const slot = Math.floor(bucket / this.span);
    const place = slot % this.capacity;
    const first = this.slots[place] !== slot;
    this.slots[place] = slot;
    for (let c = 0; c < this.columns.length; c++) {
      const to = this.columns[c], from = columns[c];
      if (first || !(to.min[place] <= from.min[row])) to.min[place] = first ? from.min[row] : lesser(to.min[place], from.min[row]);
      if (first || !(to.max[place] >= from.max[row])) to.max[place] = first ? from.max[row] : greater(to.max[place], from.max[row]);
      if (first || !Number.isNaN(from.last[row])) to.last[place] = from.last[row];
    }
  }
}

/** The lesser of two, where NaN is nothing. @param {number} a @param {number} b */
function lesser(a, b) {
  return Number.isNaN(a) || b < a ? b : a;
}

/** The greater of two, where NaN is nothing. @param {number} a @param {number} b */
function greater(a, b) {
  return Number.isNaN(a) || b > a ? b : a;
}

/** Everything received of one run. */
export class History {
  /**
   * @param {number} channelCount
   * @param {number} bucket_s length of a bucket
   */
  constructor(channelCount, bucket_s, capacity = CAPACITY) {
    this.channelCount = channelCount;
    this.bucket_s = bucket_s;
    this.fine = new Level(channelCount, 1, capacity);
    this.whole = new Level(channelCount, 1, capacity);
    /** First and newest bucket; -1 before any. */
    this.first = EMPTY;
    this.newest = EMPTY;
    /** Channels that have had a value in this run. */
    this.seen = new Array(channelCount).fill(false);
  }

  /**
   * Takes a frame. Buckets that are known already, which a reconnect brings again, change nothing.
   * @param {Buckets} frame
   */
  append(frame) {
    for (let row = 0; row < frame.time_s.length; row++) {
      const bucket = Math.round(frame.time_s[row] / this.bucket_s);
      if (!(bucket > this.newest)) continue;
      if (this.first === EMPTY) this.first = bucket;
      this.newest = bucket;
      this.fine.put(bucket, frame.channels, row);
      while (Math.floor(bucket / this.whole.span) >= this.whole.capacity) this.coarsen();
      this.whole.put(bucket, frame.channels, row);
      for (let c = 0; c < this.channelCount; c++) {
        if (!this.seen[c] && !Number.isNaN(frame.channels[c].last[row])) this.seen[c] = true;
      }
    }
  }

  /** Two slots of the whole run become one. @private */
  coarsen() {
    const old = this.whole;
    const merged = new Level(this.channelCount, old.span * 2, old.capacity);
    for (let place = 0; place < old.capacity; place++) {
      if (old.slots[place] !== EMPTY) merged.put(old.slots[place] * old.span, old.columns, place);
    }
    this.whole = merged;
  }

  /** Seconds of the run at the end of the newest bucket; 0 before any. */
  get end_s() {
    return this.newest === EMPTY ? 0 : (this.newest + 1) * this.bucket_s;
  }

  /** Seconds of the run at the start of the first bucket. */
  get start_s() {
    return this.first === EMPTY ? 0 : this.first * this.bucket_s;
  }

  /**
   * The newest value of a channel; NaN where there is none.
   * @param {number} channel
   */
  latest(channel) {
    const place = this.fine.place(this.newest);
    return place < 0 ? NaN : this.fine.columns[channel].last[place];
  }
}
