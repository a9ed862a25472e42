// Numbers and times as people read them. Units are the channels' own; nothing is converted here.

/** Digits behind the point, by unit: what the sensors resolve, and no more. */
const DIGITS = { bar: 3, deg: 2, "deg/s": 1, Nm: 2, V: 2, ml: 2, "ml/s": 2, us: 0, ms: 1, s: 1, "": 0 };

/** What stands where there is no number. */
export const NONE = "–";

/**
 * A value without its unit; {@link NONE} where there is none.
 * @param {number|null|undefined} value
 * @param {string} unit
 */
export function number(value, unit) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const digits = DIGITS[/** @type {keyof typeof DIGITS} */ (unit)] ?? 2;
  const text = value.toFixed(digits);
  // A minus before nothing but zeros would flicker at rest.
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/**
 * A value with its unit.
 * @param {number|null|undefined} value
 * @param {string} unit
 */
export function quantity(value, unit) {
  const text = number(value, unit);
  return text === NONE || unit === "" ? text : `${text} ${unitText(unit)}`;
}

/** @param {string} unit as it is written on screen */
export function unitText(unit) {
  return unit === "us" ? "µs" : unit.replace("deg", "°");
}

/**
 * Microseconds in the unit that keeps them short.
 * @param {number|null|undefined} us
 */
export function microseconds(us) {
  if (us === null || us === undefined || !Number.isFinite(us)) return NONE;
  if (us < 1000) return `${us.toFixed(us < 10 ? 1 : 0)} µs`;
  return us < 1e6 ? `${(us / 1000).toFixed(us < 1e4 ? 2 : 1)} ms` : `${(us / 1e6).toFixed(2)} s`;
}

/**
 * `m:ss`, or `h:mm:ss`.
 * @param {number|null|undefined} seconds
 */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return NONE;
  const whole = Math.max(0, Math.round(seconds));
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return h > 0 ? `${h}:${two(m)}:${two(s)}` : `${m}:${two(s)}`;
}

/**
 * A whole number in groups of three.
 * @param {number|null|undefined} n
 */
export function count(n) {
  return n === null || n === undefined ? NONE : String(n).replace(/\B(?=(\d{3})+(?!\d))/g, ",");
}

/**
 * The time of day of a UTC time, `hh:mm:ss`; the text itself where it is none.
 * @param {string} utc
 */
export function clock(utc) {
  return /T(\d\d:\d\d:\d\d)/.exec(utc)?.[1] ?? utc;
}

/**
 * Day and time of a UTC time, `yyyy-mm-dd hh:mm`.
 * @param {string} utc
 */
export function day(utc) {
  const found = /^(\d{4}-\d\d-\d\d)T(\d\d:\d\d)/.exec(utc);
  return found ? `${found[1]} ${found[2]}` : utc;
}
