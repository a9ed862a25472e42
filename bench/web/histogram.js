// How late the loop's wake-ups were in this run: counts by class, and what matters of them in numbers.

import { byId, say } from "./dom.js";
import { count, microseconds } from "./format.js";
import { all, axis, colourOf, decadesOf, readTheme } from "./theme.js";
import { uPlot } from "./uplot.js";

/**
 * Counts: below the first bound, between each two, from the last on.
 * @typedef {{bounds_us: number[], counts: number[], p50_us: number|null, p99_us: number|null, max_us: number|null, skipped: number}} Timing
 */

const HEIGHT_PX = 190;

/** The histogram of the wake-ups' lateness. */
export class Histogram {
  constructor() {
    this.host = byId("histogram");
    /** @type {Timing|null} */
    this.timing = null;
    this.rebuild();
    new ResizeObserver(() => this.resize()).observe(this.host);
  }

  rebuild() {
    this.plot?.destroy();
    const theme = readTheme();
    this.theme = theme;
    this.plot = new uPlot({
      width: 280, height: HEIGHT_PX, legend: { show: false }, cursor: { show: false }, padding: [8, 16, 0, 0],
      scales: {
        x: { time: false, distr: 3, range: () => this.range() },
        y: { distr: 3, range: () => [0.5, 10 ** Math.max(1, Math.ceil(Math.log10(Math.max(2, ...(this.timing?.counts ?? [])))))] },
      },
      axes: [
        axis(theme, { size: 24, splits: decadesOf, filter: all, values: (/** @type {any} */ _u, /** @type {number[]} */ splits) => splits.map(microsecondsShort) }),
        axis(theme, { size: 40, splits: decadesOf, filter: all, values: (/** @type {any} */ _u, /** @type {number[]} */ splits) => splits.map(countShort) }),
      ],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { draw: [(/** @type {any} */ u) => this.paint(u)] },
    }, [[1, 1000], [null, null]], this.host);
    this.resize();
  }

  /** @private */
  resize() {
    const width = this.host.clientWidth;
    if (width > 0 && width !== this.plot.width) this.plot.setSize({ width, height: HEIGHT_PX });
  }

  /** @param {Timing|null} timing null: a new run has begun */
  set(timing) {
    this.timing = timing;
    say(byId("timing-p50"), microseconds(timing?.p50_us));
    say(byId("timing-p99"), microseconds(timing?.p99_us));
    say(byId("timing-max"), microseconds(timing?.max_us));
    say(byId("timing-skipped"), count(timing?.skipped));
    byId("timing-skipped").classList.toggle("bad", (timing?.skipped ?? 0) > 0);
    this.plot.setData([this.range(), [null, null]]);
  }

  /** From the first filled class to the last, at least two decades. @private @returns {[number, number]} */
  range() {
    const timing = this.timing;
    if (!timing || !timing.counts.some((n) => n > 0)) return [1, 1000];
    const edges = this.edges(timing);
    const first = timing.counts.findIndex((n) => n > 0);
    const last = timing.counts.findLastIndex((n) => n > 0);
    const lo = 10 ** Math.floor(Math.log10(edges[first]) + 1e-9);
    const hi = 10 ** Math.ceil(Math.log10(edges[last + 1]) - 1e-9);
    return [lo, Math.max(hi, 100 * lo)];
  }

  /** Both ends of each class; the outermost, which are open, are drawn as wide as their neighbours. @private @param {Timing} timing */
  edges(timing) {
    const bounds = timing.bounds_us;
    const ratio = bounds.length > 1 ? bounds[bounds.length - 1] / bounds[bounds.length - 2] : 2;
    const first = bounds[0] > 0 ? bounds[0] / ratio : 0.5;
    return [Math.max(first, 0.1), ...bounds.map((b) => Math.max(b, 0.1)), bounds[bounds.length - 1] * ratio];
  }

  /** @private @param {any} u */
  paint(u) {
    const timing = this.timing;
    if (!timing || !this.theme) return;
    const edges = this.edges(timing);
    const { ctx, bbox } = u;
    const x = (/** @type {number} */ us) => u.valToPos(us, "x", true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.fillStyle = colourOf(this.theme, "lateness_us");
    const base = bbox.top + bbox.height;
    timing.counts.forEach((n, i) => {
      if (n === 0) return;
      const [left, right, top] = [x(edges[i]), x(edges[i + 1]), u.valToPos(n, "y", true)];
      ctx.fillRect(left + 0.5, top, Math.max(1, right - left - 1), base - top);
    });
    ctx.strokeStyle = ctx.fillStyle = this.theme.ink;
    ctx.font = this.theme.font.replace(/^\d+/, (size) => String(Number(size) * uPlot.pxRatio));
    ctx.lineWidth = uPlot.pxRatio;
    ctx.setLineDash([3 * uPlot.pxRatio, 3 * uPlot.pxRatio]);
    // Either label stands on its outer side: the two are often close.
    for (const [name, us, align, by] of /** @type {[string, number|null, CanvasTextAlign, number][]} */ ([["p50", timing.p50_us, "right", -3], ["p99", timing.p99_us, "left", 3]])) {
      if (us === null || !(us > 0)) continue;
      ctx.textAlign = align;
      ctx.beginPath();
      ctx.moveTo(x(us), bbox.top);
      ctx.lineTo(x(us), base);
      ctx.stroke();
      ctx.fillText(name, x(us) + by * uPlot.pxRatio, bbox.top + 10 * uPlot.pxRatio);
    }
    ctx.restore();
  }
}

/** @param {number} us */
function microsecondsShort(us) {
  return us >= 1e6 ? `${us / 1e6} s` : us >= 1000 ? `${us / 1000} ms` : `${us} µs`;
}

/** @param {number} n */
function countShort(n) {
  return n >= 1e6 ? `${n / 1e6}M` : n >= 1000 ? `${n / 1000}k` : String(n);
}
