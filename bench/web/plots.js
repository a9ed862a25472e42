// Curves over time: one plot for each group of channels, all with the same time axis and the same cursor.

import { calmRange, decimate, emptyView, extent } from "./decimate.js";
import { byId, make, say, show } from "./dom.js";
import { number, quantity, unitText } from "./format.js";
import { REFERENCE, all, axis, colourOf, decadesOf, readTheme } from "./theme.js";
import { uPlot } from "./uplot.js";

/**
 * @typedef {import("./live.js").Channel} Channel
 * @typedef {import("./history.js").History} History
 * @typedef {import("./decimate.js").View} View
 *
 * How a group is drawn: its title, its share of the height, the least span of its scale, and what is drawn otherwise than as curves.
 * @typedef {{title: string, share: number, least: number, kind?: "lanes"|"log"}} Group
 */

/** In the order of the page. @type {Record<string, Group>} */
const GROUPS = {
  pressure: { title: "Pressure", share: 3, least: 0.1 },
  angle: { title: "Angle", share: 2.4, least: 1 },
  difference: { title: "p1 − p2", share: 1.6, least: 0.1 },
  flow: { title: "Flow", share: 1.4, least: 1 },
  torque: { title: "Torque", share: 1.6, least: 1 },
  voltage: { title: "Voltage", share: 1.6, least: 2 },
  volume: { title: "Volume", share: 1.4, least: 1 },
  valves: { title: "Valves", share: 0, least: 1, kind: "lanes" },
  timing: { title: "Lateness", share: 1.2, least: 1, kind: "log" },
};
const OTHER = { share: 1.4, least: 1 };

const LEGEND_PX = 20;
const LANE_PX = 17;
const TIME_AXIS_PX = 26;
const LEFT_PX = 52;
const LOG_LEAST_US = 1;

/** All plots over time. */
export class TimePlots {
  constructor() {
    this.host = byId("plots");
    /** @type {Channel[]} */
    this.channels = [];
    /** @type {View} */
    this.view = emptyView(0);
    /** @type {TimePlot[]} */
    this.plots = [];
    /** The button of each group. @type {Map<string, HTMLElement>} */
    this.chips = new Map();
    this.shown = "";
    /** Groups that the user switched off. @type {Set<string>} */
    this.off = new Set();
    this.sync = uPlot.sync("time");
    new ResizeObserver(() => this.layOut()).observe(this.host);
  }

  /** @param {Channel[]} channels */
  setChannels(channels) {
    this.channels = channels;
    this.view = emptyView(channels.length);
    this.shown = "";
    this.offerGroups();
  }

  /** A button for each group, to switch it off and on. @private */
  offerGroups() {
    this.chips = new Map(this.groups().map((group) => {
      const button = make("button", "chip", titleOf(group));
      button.setAttribute("type", "button");
      button.setAttribute("aria-pressed", String(!this.off.has(group)));
      button.onclick = () => {
        if (!this.off.delete(group)) this.off.add(group);
        button.setAttribute("aria-pressed", String(!this.off.has(group)));
        this.refresh();
      };
      return [group, button];
    }));
    byId("groups").replaceChildren(...this.chips.values());
  }

  /** Draws the same view again: after a change of what is shown. */
  refresh() {
    if (this.history) this.drawView(this.history);
  }

  /** Names of the groups, in the page's order. @private */
  groups() {
    const named = [...new Set(this.channels.map((channel) => channel.group))];
    const known = Object.keys(GROUPS);
    const place = (/** @type {string} */ group) => (known.includes(group) ? known.indexOf(group) : known.length);
    return named.sort((a, b) => place(a) - place(b));
  }

  /** What is reckoned from other channels is shown where something is asked of it. @private @param {string} group @param {History} history */
  hasValues(group, history) {
    return this.channelsOf(group).some(({ index, derived }) => history.seen[index] && !derived);
  }

  /** @private @param {string} group */
  channelsOf(group) {
    return this.channels.map((channel, index) => ({ ...channel, index })).filter((channel) => channel.group === group);
  }

  /**
   * Draws the window that ends with the newest values.
   * @param {History} history
   * @param {number|null} window_s null: the whole run
   */
  draw(history, window_s) {
    const columns = Math.max(100, this.host.clientWidth - LEFT_PX - 8);
    decimate(history, window_s, columns, this.view);
    this.drawView(history);
  }

  /** @private @param {History} history */
  drawView(history) {
    this.history = history;
    const wanted = this.groups().filter((group) => !this.off.has(group));
    const filled = wanted.filter((group) => this.hasValues(group, history));
    for (const [group, chip] of this.chips) {
      const empty = history.newest >= 0 && !this.hasValues(group, history);
      chip.classList.toggle("empty", empty);
      chip.title = empty ? "no values in this run" : "";
      // What only some scripts ask for has no place on the page otherwise.
      show(chip, !empty || this.channelsOf(group).some(({ name, derived }) => !derived && !name.startsWith(REFERENCE)));
    }
    show(byId("no-data"), filled.length === 0);
    if (this.shown !== filled.join()) this.build(filled);
    for (const plot of this.plots) plot.draw(this.view, history);
  }

  /** New plots: another run has other channels, the scheme has other colours. */
  rebuild() {
    this.shown = "";
    this.refresh();
  }

  /** @private @param {string[]} groups */
  build(groups) {
    this.shown = groups.join();
    for (const plot of this.plots) plot.destroy();
    this.host.replaceChildren();
    const theme = readTheme();
    const last = groups.length - 1;
    this.plots = groups.map((group, i) => new TimePlot(this.host, group, this.channelsOf(group), this.view, theme, i === last, this.sync.key));
    this.layOut();
  }

  /** Divides the height among the plots. @private */
  layOut() {
    const width = this.host.clientWidth;
    if (width === 0 || this.plots.length === 0) return;
    const shares = this.plots.reduce((sum, plot) => sum + plot.group.share, 0);
    const fixed = this.plots.reduce((sum, plot) => sum + LEGEND_PX + plot.fixed_px, 0);
    const free = this.host.clientHeight - fixed;
    for (const plot of this.plots) {
      const height = plot.group.share === 0 ? 0 : Math.max(60, (free * plot.group.share) / shares);
      plot.resize(width, Math.floor(height + plot.fixed_px));
    }
  }
}

/** @param {string} group */
function titleOf(group) {
  return GROUPS[group]?.title ?? group;
}

/** One group of channels over time. */
class TimePlot {
  /**
   * @param {HTMLElement} host
   * @param {string} name
   * @param {(Channel & {index: number})[]} channels
   * @param {View} view
   * @param {import("./theme.js").Theme} theme
   * @param {boolean} withTime draws the labels of the time axis
   * @param {string} syncKey
   */
  constructor(host, name, channels, view, theme, withTime, syncKey) {
    this.group = GROUPS[name] ?? { title: name, ...OTHER };
    // References lie over what they are the reference of.
    const isReference = (/** @type {Channel} */ channel) => channel.name.startsWith(REFERENCE);
    this.channels = [...channels.filter((channel) => !isReference(channel)), ...channels.filter(isReference)];
    this.view = view;
    this.fixed_px = (withTime ? TIME_AXIS_PX : 0) + (this.group.kind === "lanes" ? LANE_PX * channels.length + 4 : 0);
    /** @type {[number, number]|null} */
    this.range = null;

    const figure = make("section", "plot");
    figure.setAttribute("aria-label", `${this.group.title} over time`);
    const legend = make("div", "legend");
    legend.append(make("strong", "", this.group.title));
    this.values = this.channels.map((channel) => {
      const entry = make("span", "entry");
      const swatch = make("i", isReference(channel) ? "swatch dashed" : "swatch");
      swatch.style.color = colourOf(theme, channel.name);
      const value = make("b");
      entry.append(swatch, `${this.group.kind === "lanes" ? laneLabel(channel.label) : channel.label} `, value);
      legend.append(entry);
      return { entry, value };
    });
    figure.append(legend);
    host.append(figure);
    this.figure = figure;

    const lanes = this.group.kind === "lanes";
    const log = this.group.kind === "log";
    const yAxis = lanes
      ? axis(theme, { size: LEFT_PX, splits: () => this.channels.map((_, lane) => lane + 0.5), values: () => this.channels.map((c) => laneLabel(c.label)), grid: { show: false }, ticks: { show: false } })
      : axis(theme, { size: LEFT_PX, space: log ? 18 : 26, ...(log ? { splits: decadesOf, filter: all, values: decades } : {}) });
    this.plot = new uPlot({
      width: 300, height: 60, legend: { show: false }, padding: [7, 10, withTime ? 0 : 7, 0],
      cursor: { sync: { key: syncKey, scales: ["x", null] }, drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: { x: { time: false }, y: { distr: log ? 3 : 1, range: () => this.range ?? [0, 1] } },
      axes: [
        axis(theme, withTime ? { size: TIME_AXIS_PX, space: 60, values: seconds } : { size: 0, values: () => [], ticks: { show: false } }),
        yAxis,
      ],
      series: [{}, ...this.channels.map((channel, i) => {
        const colour = colourOf(theme, channel.name);
        return isReference(channel)
          ? { stroke: theme.ink, width: 1.25, dash: [6, 6], points: { show: false }, paths: this.line(channel.index) }
          : lanes
            ? { fill: colour, width: 0, points: { show: false }, paths: this.lane(channel.index, i) }
            : { stroke: colour, fill: translucent(colour), width: 1.75, points: { show: false }, paths: this.bandAndLine(channel.index) };
      })],
      hooks: { setCursor: [() => this.readOut()] },
    }, [[0, 1], ...this.channels.map(() => [null, null])], figure);
  }

  destroy() {
    this.plot.destroy();
  }

  /** @param {number} width @param {number} height */
  resize(width, height) {
    if (this.plot.width !== width || this.plot.height !== height) this.plot.setSize({ width, height });
  }

  /**
   * @param {View} view
   * @param {History} history
   */
  draw(view, history) {
    this.view = view;
    this.scale();
    this.plot.batch(() => {
      this.plot.setData([view.x, ...this.channels.map(({ index }) => view.series[index].last)], false);
      this.plot.setScale("x", { min: view.from_s, max: Math.max(view.to_s, view.from_s + view.column_s) });
    });
    this.channels.forEach(({ index, name }, i) => show(this.values[i].entry, history.seen[index] || !name.startsWith(REFERENCE)));
    this.readOut();
  }

  /** @private */
  scale() {
    if (this.group.kind === "lanes") {
      this.range = [0, this.channels.length];
      return;
    }
    const values = extent(this.view, this.channels.map(({ index }) => index));
    if (this.group.kind === "log") {
      // Whole decades: the scale stands still.
      const most = Math.max(values?.[1] ?? 0, this.range?.[1] ?? 0, 100);
      this.range = [LOG_LEAST_US, 10 ** Math.ceil(Math.log10(most))];
    } else {
      this.range = calmRange(this.range, values, this.group.least);
    }
  }

  /** Values at the cursor, otherwise the newest. @private */
  readOut() {
    const left = this.plot.cursor.left ?? -1;
    const at = left >= 0 && this.view.x.length ? this.plot.posToIdx(left) : this.view.x.length - 1;
    this.channels.forEach((channel, i) => {
      const { min, max, last } = this.view.series[channel.index];
      const [a, b] = [min[at] ?? null, max[at] ?? null];
      if (this.group.kind === "lanes") {
        say(this.values[i].value, last[at] === null || last[at] === undefined ? "–" : last[at] > 0.5 ? "open" : "closed");
        return;
      }
      let text = quantity(last[at], channel.unit);
      // Where the cursor asks for one column, what lies within it counts, too.
      if (left >= 0 && a !== null && b !== null && number(a, channel.unit) !== number(b, channel.unit)) {
        text = `${quantity(last[at], channel.unit)}  (${number(a, channel.unit)} … ${number(b, channel.unit)})`;
      }
      say(this.values[i].value, text);
    });
  }

  /**
   * Path of a channel: a bar from the least to the greatest value of each column, which keeps every spike, and the line of the last values.
   * @private
   * @param {number} channel
   */
  bandAndLine(channel) {
    const line = this.line(channel);
    return (/** @type {any} */ u, /** @type {number} */ s, /** @type {number} */ i0, /** @type {number} */ i1) => {
      const { min, max } = this.view.series[channel];
      const fill = new Path2D();
      const wide = Math.max(1.5 * uPlot.pxRatio, Math.abs(this.x(u, this.view.column_s) - this.x(u, 0)));
      for (let i = i0; i <= i1; i++) {
        const [lo, hi] = [min[i], max[i]];
        if (lo === null || hi === null || lo === undefined || hi === undefined) continue;
        const [top, bottom] = [this.y(u, hi), this.y(u, lo)];
        // What the line covers need not be filled.
        if (bottom - top > 2.5 * uPlot.pxRatio) fill.rect(this.x(u, this.view.x[i]) - wide, top, wide, bottom - top);
      }
      return { ...line(u, s, i0, i1), fill };
    };
  }

  /**
   * Path through the last values; it ends where a column has none.
   * @private
   * @param {number} channel
   */
  line(channel) {
    return (/** @type {any} */ u, /** @type {number} */ _s, /** @type {number} */ i0, /** @type {number} */ i1) => {
      const { last } = this.view.series[channel];
      const stroke = new Path2D();
      let drawn = false;
      for (let i = i0; i <= i1; i++) {
        const value = last[i];
        if (value === null || value === undefined) {
          drawn = false;
          continue;
        }
        const [x, y] = [this.x(u, this.view.x[i]), this.y(u, value)];
        if (drawn) stroke.lineTo(x, y);
        else {
          stroke.moveTo(x, y);
          // A lone value between gaps is a dot.
          stroke.lineTo(x + 0.01, y);
        }
        drawn = true;
      }
      return { stroke, fill: null, clip: null, band: null, gaps: null, flags: 0 };
    };
  }

  /**
   * Path of a valve: a bar in its lane while it is open; half as high where it was both within a column.
   * @private
   * @param {number} channel
   * @param {number} lane
   */
  lane(channel, lane) {
    return (/** @type {any} */ u, /** @type {number} */ _s, /** @type {number} */ i0, /** @type {number} */ i1) => {
      const { min, max } = this.view.series[channel];
      const fill = new Path2D();
      const wide = Math.abs(this.x(u, this.view.column_s) - this.x(u, 0));
      const base = this.y(u, lane + 0.12);
      for (let i = i0; i <= i1; i++) {
        const [lo, hi] = [min[i], max[i]];
        if (lo === null || hi === null || lo === undefined || hi === undefined) continue;
        const open = hi < 0.5 ? 0.06 : lo < 0.5 ? 0.4 : 0.76;
        const top = this.y(u, lane + 0.12 + open);
        fill.rect(this.x(u, this.view.x[i]) - wide, top, wide + 0.5, base - top);
      }
      return { stroke: null, fill, clip: null, band: null, gaps: null, flags: 0 };
    };
  }

  /** @private @param {any} u @param {number} time_s */
  x(u, time_s) {
    return u.valToPos(time_s, "x", true);
  }

  /** @private @param {any} u @param {number} value */
  y(u, value) {
    return u.valToPos(this.group.kind === "log" ? Math.max(value, LOG_LEAST_US) : value, "y", true);
  }
}

/** A valve's name without the state that its channel is 1 for. @param {string} label */
function laneLabel(label) {
  return label.replace(/ open$/, "");
}

/** @param {string} colour as the style sheet has it, #rrggbb */
function translucent(colour) {
  return `${colour}90`;
}

/** @param {any} _u @param {number[]} splits */
function seconds(_u, splits) {
  return splits.map((s) => `${Number(s.toFixed(3))} s`);
}

/** @param {any} _u @param {number[]} splits in microseconds */
function decades(_u, splits) {
  return splits.map((us) => (us >= 1000 ? `${us / 1000} ms` : `${us} ${unitText("us")}`));
}
