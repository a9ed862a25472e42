// The frames of the live stream, as docs/SERVICE.md describes them.

import assert from "node:assert/strict";
import test from "node:test";
import { decodeBuckets } from "../../web/live.js";
import { frame } from "./frames.js";

test("a frame gives back times and least, greatest, last of each channel", () => {
  const bytes = frame(7, [0.5, 0.51], [
    { min: [1, -2], max: [3, NaN], last: [2, 0.25] },
    { min: [10, 11], max: [12, 13], last: [14, 15] },
  ]);
  const buckets = decodeBuckets(bytes, 2);
  assert.equal(buckets.run, 7);
  assert.deepEqual([...buckets.time_s], [0.5, 0.51]);
  assert.deepEqual([...buckets.channels[0].min], [1, -2]);
  assert.deepEqual([...buckets.channels[0].max], [3, NaN]);
  assert.deepEqual([...buckets.channels[0].last], [2, 0.25]);
  assert.deepEqual(buckets.channels[1], {
    min: new Float32Array([10, 11]), max: new Float32Array([12, 13]), last: new Float32Array([14, 15]),
  });
});

test("a frame without buckets is one", () => {
  assert.equal(decodeBuckets(frame(1, [], [{ min: [], max: [], last: [] }]), 1).time_s.length, 0);
});

test("another kind of frame is left to later versions", () => {
  const bytes = frame(1, [0], [{ min: [0], max: [0], last: [0] }]);
  new DataView(bytes).setUint32(0, 2, true);
  assert.equal(decodeBuckets(bytes, 1), null);
});

test("a frame that is not what its header says is refused with both sizes", () => {
  const bytes = frame(1, [0, 0.01], [{ min: [0, 0], max: [0, 0], last: [0, 0] }]);
  assert.throws(() => decodeBuckets(bytes.slice(0, 8), 1), /expected a frame of 16 bytes or more, got 8/);
  assert.throws(() => decodeBuckets(bytes.slice(0, -4), 1), /expected 56 bytes for 2 buckets, got 52/);
  assert.throws(() => decodeBuckets(bytes, 2), /expected 2 channels, got 1/);
});
