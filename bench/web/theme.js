// Colours and fonts of the canvases, taken from the style sheet, so that there is one place for them and the scheme of the system is followed.

/**
 * @typedef {{ink: string, faint: string, grid: string, alarm: string, font: string, series: Record<string, string>}} Theme
 */

/** Colour of each channel, as the style sheet's variables name it; what is not known here takes the next one. */
const COLOURS = {
  pressure1_bar: "--c-pressure1", pressure2_bar: "--c-pressure2", angle_deg: "--c-angle", torque_nm: "--c-torque",
  voltage_v: "--c-voltage", pressure_difference_bar: "--c-pressure1", volume_ml: "--c-volume", brake_open: "--c-brake", bypass_open: "--c-bypass", lateness_us: "--c-lateness",
};

/** A reference is named after its channel. */
export const REFERENCE = "reference_";

/** @returns {Theme} */
export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const get = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
  const series = Object.fromEntries(Object.entries(COLOURS).map(([name, variable]) => [name, get(variable)]));
  return { ink: get("--ink"), faint: get("--faint"), grid: get("--grid"), alarm: get("--alarm"), font: `11px ${get("--sans")}`, series };
}

/**
 * Colour of a channel or of its reference.
 * @param {Theme} theme
 * @param {string} name
 */
export function colourOf(theme, name) {
  return theme.series[name] ?? theme.series[name.replace(REFERENCE, "")] ?? theme.ink;
}

/**
 * An axis of uPlot in the page's style.
 * @param {Theme} theme
 * @param {object} more
 */
export function axis(theme, more) {
  return {
    stroke: theme.faint, font: theme.font, labelFont: theme.font,
    grid: { stroke: theme.grid, width: 1 }, ticks: { stroke: theme.grid, width: 1, size: 4 }, gap: 4, ...more,
  };
}

/**
 * Splits of a logarithmic axis of uPlot: whole decades, and nothing between them.
 * @param {any} _u
 * @param {number} _axis
 * @param {number} min
 * @param {number} max
 */
export function decadesOf(_u, _axis, min, max) {
  const splits = [];
  for (let power = Math.ceil(Math.log10(min) - 1e-9); power <= Math.log10(max) + 1e-9; power++) splits.push(10 ** power);
  return splits;
}

/** Of a logarithmic axis: every split has its label; uPlot would leave some out. @param {any} _u @param {number[]} splits */
export function all(_u, splits) {
  return splits;
}

/**
 * Calls back when the system's colour scheme changes.
 * @param {() => void} changed
 */
export function onThemeChange(changed) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
}
