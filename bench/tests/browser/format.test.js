// Numbers and times on screen.

import assert from "node:assert/strict";
import test from "node:test";
import { clock, count, day, duration, microseconds, number, quantity } from "../../web/format.js";

test("values carry the digits of their unit, a true minus, and none at zero", () => {
  assert.equal(quantity(2.3456, "bar"), "2.346 bar");
  assert.equal(quantity(-12.345, "deg"), "−12.35 °");
  assert.equal(number(-0.001, "V"), "0.00");
  assert.equal(quantity(NaN, "bar"), "–");
  assert.equal(quantity(null, "bar"), "–");
});

test("times", () => {
  assert.equal(duration(81.4), "1:21");
  assert.equal(duration(3725), "1:02:05");
  assert.equal(duration(-1), "0:00");
  assert.equal(duration(null), "–");
  assert.equal(clock("2026-11-20T20:32:56.123Z"), "20:32:56");
  assert.equal(day("2026-11-20T20:32:56.123Z"), "2026-11-20 20:32");
  assert.equal(clock("unknown"), "unknown");
});

test("counts and microseconds", () => {
  assert.equal(count(1234567), "1,234,567");
  assert.equal(count(null), "–");
  assert.deepEqual([4.2, 133, 1533, 28_400, 2.5e6].map(microseconds), ["4.2 µs", "133 µs", "1.53 ms", "28.4 ms", "2.50 s"]);
});
