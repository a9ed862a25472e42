// Phase plots: pressures and torque over the angle, in the window of the time plots. The path fades towards the past; a dot is now.

import { calmRange, extent } from "./decimate.js";
import { byId, make, show } from "./dom.js";
import { axis, colourOf, readTheme } from "./theme.js";
import { uPlot } from "./uplot.js";

/**
 * @typedef {import("./live.js").Channel} Channel
 * @typedef {import("./decimate.js").View} View
 */

/** What is drawn over the angle. Each plot is shown once its channels have been measured. */
const PLOTS = [
  { title: "Pressure over angle", over: ["pressure1_bar", "pressure2_bar"], unit: "bar", least: 0.1 },
  { title: "Torque over angle", over: ["torque_nm"], unit: "Nm", least: 1 },
];
const ANGLE = "angle_deg";
/** Of one plot alone, and of each of two. */
const HEIGHTS_PX = [400, 236];
/** Stretches of one shade each: the oldest is the faintest. */
const SHADES = 6;

/** The phase plots of a run. */
export class PhasePlots {
  constructor() {
    this.host = byId("phase");
    /** @type {Phase[]} */
    this.plots = [];
    /** @type {Channel[]} */
    this.channels = [];
    new ResizeObserver(() => this.plots.forEach((plot) => plot.resize())).observe(this.host);
  }

  /** @param {Channel[]} channels */
  setChannels(channels) {
    this.channels = channels;
    this.rebuild();
  }

  rebuild() {
    for (const plot of this.plots) plot.plot.destroy();
    this.host.replaceChildren();
    const theme = readTheme();
    const index = (/** @type {string} */ name) => this.channels.findIndex((channel) => channel.name === name);
    const angle = index(ANGLE);
    this.plots = angle < 0 ? [] : PLOTS.map((what) => {
      const ys = what.over.map((name) => ({ name, index: index(name) })).filter((y) => y.index >= 0);
      return new Phase(this.host, what, angle, ys, theme);
    });
  }

  /**
   * @param {View} view
   * @param {boolean[]} seen
   */
  draw(view, seen) {
    for (const plot of this.plots) plot.draw(view, seen);
  }
}

class Phase {
  /**
   * @param {HTMLElement} host
   * @param {{title: string, unit: string, least: number}} what
   * @param {number} angle
   * @param {{name: string, index: number}[]} ys
   * @param {import("./theme.js").Theme} theme
   */
  constructor(host, what, angle, ys, theme) {
    this.what = what;
    this.angle = angle;
    this.ys = ys;
    this.theme = theme;
    /** @type {View|null} */
    this.view = null;
    /** @type {[number, number]|null} */
    this.xRange = null;
    /** @type {[number, number]|null} */
    this.yRange = null;
    this.figure = make("section", "plot");
    this.figure.setAttribute("aria-label", what.title);
    const legend = make("div", "legend");
    legend.append(make("strong", "", what.title), make("span", "entry", `${what.unit} over °`));
    this.figure.append(legend);
    host.append(this.figure);
    this.plot = new uPlot({
      width: 280, height: HEIGHTS_PX[1], legend: { show: false }, cursor: { show: false }, padding: [7, 10, 0, 0],
      scales: { x: { time: false, range: () => this.xRange ?? [-1, 1] }, y: { range: () => this.yRange ?? [0, 1] } },
      axes: [axis(theme, { size: 24, space: 45 }), axis(theme, { size: 40, space: 30 })],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { draw: [(/** @type {any} */ u) => this.paint(u)] },
    }, [[-1, 1], [null, null]], this.figure);
    this.resize();
  }

  resize() {
    const beside = [...this.figure.parentElement?.children ?? []].filter((other) => !(/** @type {HTMLElement} */ (other).hidden)).length;
    const width = this.figure.clientWidth;
    // Below each other and as high as wide at most, so that a narrow screen is not filled by one of them.
    const height = Math.min(HEIGHTS_PX[Math.min(beside, 2) - 1] ?? HEIGHTS_PX[1], Math.max(width, HEIGHTS_PX[1]));
    if (width > 0 && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
  }

  /**
   * @param {View} view
   * @param {boolean[]} seen
   */
  draw(view, seen) {
    const measured = seen[this.angle] && this.ys.some((y) => seen[y.index]);
    show(this.figure, measured);
    if (!measured) return;
    this.resize();
    this.view = view;
    this.xRange = calmRange(this.xRange, extent(view, [this.angle], true), 2);
    this.yRange = calmRange(this.yRange, extent(view, this.ys.map((y) => y.index), true), this.what.least);
    this.plot.setData([this.xRange, [null, null]]);
  }

  /** @private @param {any} u */
  paint(u) {
    if (!this.view) return;
    const angles = this.view.series[this.angle].last;
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.lineWidth = 1.5 * uPlot.pxRatio;
    ctx.lineJoin = "round";
    for (const { name, index } of this.ys) {
      const values = this.view.series[index].last;
      ctx.strokeStyle = ctx.fillStyle = colourOf(this.theme, name);
      const length = angles.length;
      /** @type {[number, number]|null} */
      let now = null;
      for (let shade = 0; shade < SHADES; shade++) {
        ctx.globalAlpha = 0.2 + (0.8 * shade) / (SHADES - 1);
        ctx.beginPath();
        const from = Math.floor((length * shade) / SHADES), to = Math.min(length - 1, Math.floor((length * (shade + 1)) / SHADES));
        let drawn = false;
        for (let i = from; i <= to; i++) {
          const [angle, value] = [angles[i], values[i]];
          if (angle === null || value === null || angle === undefined || value === undefined) {
            drawn = false;
            continue;
          }
          now = [u.valToPos(angle, "x", true), u.valToPos(value, "y", true)];
          if (drawn) ctx.lineTo(now[0], now[1]);
          else ctx.moveTo(now[0], now[1]);
          drawn = true;
        }
        ctx.stroke();
      }
      ctx.globalAlpha = 1;
      if (now) {
        ctx.beginPath();
        ctx.arc(now[0], now[1], 4.5 * uPlot.pxRatio, 0, 2 * Math.PI);
        ctx.fill();
      }
    }
    ctx.restore();
  }
}
