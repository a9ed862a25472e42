// From buckets to columns of the screen: nothing that was measured may disappear, nothing that was not may appear.

import assert from "node:assert/strict";
import test from "node:test";
import { calmRange, decimate, extent, niceStep } from "../../web/decimate.js";
import { History } from "../../web/history.js";
import { decodeBuckets } from "../../web/live.js";
import { frame } from "./frames.js";

const BUCKET_S = 0.01;

/** A history of `value(bucket)` for the buckets from..to, in frames of 4 as the service sends them; null leaves a bucket out. */
function filled(from, to, value, capacity = 8192) {
  const history = new History(1, BUCKET_S, capacity);
  for (let first = from; first < to; first += 4) {
    const numbers = [...Array(Math.min(4, to - first)).keys()].map((i) => first + i).filter((n) => value(n) !== null);
    const rows = numbers.map(value).map((v) => (typeof v === "number" ? { min: v, max: v, last: v } : v));
    const column = (key) => rows.map((row) => row[key]);
    const bytes = frame(1, numbers.map((n) => n * BUCKET_S), [{ min: column("min"), max: column("max"), last: column("last") }]);
    history.append(decodeBuckets(bytes, 1));
  }
  return history;
}

const spike = (at, level = 9) => (n) => (n === at ? { min: 1, max: level, last: 1 } : 1);

for (const columns of [100, 337, 1000, 5000]) {
  test(`a spike of one sample is in the picture, ${columns} columns`, () => {
    for (const at of [4000, 4001, 4999, 5999]) {
      const view = decimate(filled(0, 6000, spike(at)), 30, columns);
      assert.deepEqual(extent(view, [0]), [1, 9], `spike in bucket ${at}`);
      assert.equal(view.series[0].max.filter((v) => v === 9).length, 1);
      // At its own time: the column ends after the bucket begins, at most one column later.
      const end = view.x[view.series[0].max.indexOf(9)];
      assert.ok(end > at * BUCKET_S - 1e-9 && end <= at * BUCKET_S + view.column_s + 1e-9, `${end} s for ${at * BUCKET_S} s`);
    }
  });
}

test("the whole of a long run keeps its spikes, downward ones too, in arrays of fixed size", () => {
  const hour = 360_000;
  const history = filled(0, hour, (n) => (n === 1234 ? { min: 1, max: 8, last: 1 } : n === 200_001 ? { min: -5, max: 1, last: 1 } : 1));
  const view = decimate(history, null, 800);
  assert.ok(view.x.length <= 802, `${view.x.length} columns`);
  assert.deepEqual(extent(view, [0]), [-5, 8]);
  assert.equal(history.whole.columns[0].min.length, 8192);
  assert.ok(Math.abs(view.x.at(-1) - hour * BUCKET_S) <= view.column_s);
  assert.ok(view.series[0].last.every((value) => value === 1));
});

test("missing buckets are a gap of their own length, however they are missing", () => {
  const lacking = (n) => (n >= 500 && n < 550 ? null : 1);
  const silent = (n) => (n >= 500 && n < 550 ? { min: NaN, max: NaN, last: NaN } : 1);
  for (const value of [lacking, silent]) {
    const view = decimate(filled(0, 1000, value), 10, 2000);
    const gaps = view.x.filter((_, i) => view.series[0].last[i] === null);
    assert.equal(gaps.length, 50);
    assert.ok(Math.abs(gaps[0] - 5.01) < 1e-9 && Math.abs(gaps[49] - 5.5) < 1e-9);
    assert.ok(view.series[0].min.every((v, i) => (v === null) === (view.series[0].last[i] === null)));
  }
});

test("a bucket in which samples are missing breaks the line and keeps what came", () => {
  const view = decimate(filled(0, 1000, (n) => (n === 700 ? { min: 0, max: 5, last: NaN } : 1)), 10, 2000);
  const at = view.x.findIndex((x) => Math.abs(x - 7.01) < 1e-9);
  assert.deepEqual([view.series[0].last[at], view.series[0].max[at]], [null, 5]);
});

test("what a reconnect sends again changes nothing", () => {
  const history = filled(0, 1000, (n) => n);
  const again = filled(900, 1000, () => -1);
  const rows = [...Array(100).keys()];
  history.append({ run: 1, time_s: Float64Array.from(rows, (i) => (900 + i) * BUCKET_S), channels: [again.fine.columns[0]] });
  assert.deepEqual(extent(decimate(history, 10, 5000), [0]), [0, 999]);
});

test("columns lie on multiples of their length, so a moving window does not sort samples anew", () => {
  const wave = (n) => Math.sin(n / 7);
  const before = decimate(filled(0, 2000, wave), 10, 150);
  const after = decimate(filled(0, 2004, wave), 10, 150);
  const known = new Map(before.x.map((x, i) => [x.toFixed(6), before.series[0].max[i]]));
  const shared = after.x.map((x, i) => [x.toFixed(6), after.series[0].max[i]]).filter(([x]) => known.has(x)).slice(0, -1);
  assert.ok(shared.length > 100);
  for (const [x, value] of shared.slice(1)) assert.equal(value, known.get(x), `column at ${x} s`);
});

test("the ring forgets what is older than it is long, and does not show it as something newer", () => {
  const history = filled(0, 1000, (n) => n, 256);
  const view = decimate(history, 2, 5000);
  assert.equal(extent(view, [0])[0], 1000 - 201);
  assert.equal(history.latest(0), 999);
});

test("a run that is joined late begins where its history begins", () => {
  const view = decimate(filled(50_000, 51_000, () => 2), null, 500);
  assert.equal(view.from_s, 500);
  assert.deepEqual(extent(view, [0]), [2, 2]);
});

test("nothing received is nothing drawn", () => {
  const view = decimate(new History(2, BUCKET_S), 10, 500);
  assert.deepEqual([view.x.length, extent(view, [0, 1])], [0, null]);
});

test("a scale holds all values, stays while they move within it, and shrinks when half of it is empty", () => {
  const first = calmRange(null, [1.02, 3.97], 0.1);
  assert.ok(first[0] <= 1.02 && first[1] >= 3.97);
  assert.equal(calmRange(first, [1.3, 3.6], 0.1), first);
  assert.ok(calmRange(first, [1.5, 7], 0.1)[1] >= 7);
  assert.ok(calmRange(first, [2, 2.2], 0.1)[1] < 3);
  const rest = calmRange(null, [2, 2.0001], 0.1);
  assert.ok(rest[1] - rest[0] >= 0.1, "noise at rest is not blown up");
  assert.deepEqual([niceStep(0.3), niceStep(0.5), niceStep(1.1), niceStep(70)], [0.5, 0.5, 2, 100]);
});
