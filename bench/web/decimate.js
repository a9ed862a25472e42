// From slots of the history to columns of the screen. A column holds the least, the greatest and the last value of its slots, so nothing that
// was measured is left out of the picture, however long the window is.

/** @typedef {import("./history.js").History} History */

/**
 * Values of a channel by column; null where nothing was measured.
 * @typedef {{min: (number|null)[], max: (number|null)[], last: (number|null)[]}} Series
 *
 * What is drawn: the end of each column in seconds of the run, and the values by channel.
 * @typedef {{from_s: number, to_s: number, column_s: number, x: number[], series: Series[]}} View
 */

/**
 * The columns of a window that ends with the newest bucket.
 * @param {History} history
 * @param {number|null} window_s null: the whole run
 * @param {number} most columns at most, about one a pixel
 * @param {View} [reuse] a view whose arrays are filled anew
 * @returns {View}
 */
export function decimate(history, window_s, most, reuse) {
  const view = reuse ?? emptyView(history.channelCount);
  const level = window_s === null || window_s / history.bucket_s > history.fine.capacity ? history.whole : history.fine;
  const to_s = history.end_s;
  view.to_s = to_s;
  view.from_s = window_s === null ? history.start_s : to_s - window_s;
  const slot_s = history.bucket_s * level.span;
  // Columns lie on multiples of their own length, so that a moving window does not sort the same samples into others each time.
  const merged = Math.max(1, Math.ceil((view.to_s - view.from_s) / slot_s / most));
  view.column_s = slot_s * merged;
  const newest = Math.floor(history.newest / level.span);
  // Half a bucket of tolerance: times are multiples of the bucket up to rounding. One column more, so that the line enters from outside.
  const from = Math.max(0, Math.floor((view.from_s / slot_s + 0.5 / level.span) / merged) - 1);
  const to = Math.floor(newest / merged);
  const columns = history.newest < 0 ? 0 : Math.max(0, to - from + 1);
  view.x.length = columns;
  for (const s of view.series) s.min.length = s.max.length = s.last.length = columns;
  for (let column = 0; column < columns; column++) {
    const first = (from + column) * merged;
    view.x[column] = (from + column + 1) * view.column_s;
    for (const s of view.series) s.min[column] = s.max[column] = s.last[column] = null;
    for (let slot = first; slot < first + merged; slot++) {
      const place = level.place(slot);
      if (place < 0) continue;
      for (let c = 0; c < view.series.length; c++) take(view.series[c], column, level.columns[c], place);
    }
  }
  return view;
}

/**
 * @param {Series} to
 * @param {number} column
 * @param {import("./history.js").Column} from
 * @param {number} place
 */
function take(to, column, from, place) {
  const min = from.min[place], max = from.max[place], last = from.last[place];
  const [known_min, known_max] = [to.min[column], to.max[column]];
  if (!Number.isNaN(min) && (known_min === null || min < known_min)) to.min[column] = min;
  if (!Number.isNaN(max) && (known_max === null || max > known_max)) to.max[column] = max;
  if (!Number.isNaN(last)) to.last[column] = last;
}

/**
 * @param {number} channelCount
 * @returns {View}
 */
export function emptyView(channelCount) {
  return {
    from_s: 0, to_s: 1, column_s: 1, x: [],
    series: Array.from({ length: channelCount }, () => ({ min: [], max: [], last: [] })),
  };
}

/**
 * Least and greatest value of some channels in a view; null where there is none.
 * @param {View} view
 * @param {number[]} channels
 * @param {boolean} [lastOnly] of the last value of each column alone
 * @returns {[number, number]|null}
 */
export function extent(view, channels, lastOnly = false) {
  let [lo, hi] = [Infinity, -Infinity];
  for (const c of channels) {
    const { min, max } = lastOnly ? { min: view.series[c].last, max: view.series[c].last } : view.series[c];
    for (let i = 0; i < min.length; i++) {
      const [a, b] = [min[i], max[i]];
      if (a !== null && a < lo) lo = a;
      if (b !== null && b > hi) hi = b;
    }
  }
  return lo <= hi ? [lo, hi] : null;
}

/**
 * A scale that holds all values and stays put while they move within it: it grows at once and shrinks when half of it is empty.
 * @param {[number, number]|null} before
 * @param {[number, number]|null} values
 * @param {number} least span in the channel's unit; noise at rest is not blown up to the full height
 * @returns {[number, number]}
 */
export function calmRange(before, values, least) {
  if (!values) return before ?? [0, least];
  let [lo, hi] = values;
  if (hi - lo < least) [lo, hi] = [(lo + hi - least) / 2, (lo + hi + least) / 2];
  if (before && before[0] <= lo && hi <= before[1] && before[1] - before[0] <= 2 * (hi - lo)) return before;
  const step = niceStep((hi - lo) / 8);
  return [Math.floor(lo / step - 0.2) * step, Math.ceil(hi / step + 0.2) * step];
}

/** The next of 1, 2, 5, 10, ... from this size on. @param {number} size */
export function niceStep(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return [1, 2, 5, 10].map((n) => n * power).find((step) => step >= size * (1 - 1e-9)) ?? 10 * power;
}
