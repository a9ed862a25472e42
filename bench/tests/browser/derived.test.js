// What the page reckons itself.

import assert from "node:assert/strict";
import test from "node:test";
import { Derived } from "../../web/derived.js";
import { decodeBuckets } from "../../web/live.js";
import { frame } from "./frames.js";

const channel = (name, group) => ({ name, label: name, unit: "bar", group });
const PRESSURES = [channel("pressure1_bar", "pressure"), channel("pressure2_bar", "pressure")];

test("a reference of the pressure difference has the difference beside it, in a plot of its own", () => {
  const derived = new Derived([...PRESSURES, channel("reference_pressure_difference_bar", "pressure")]);
  assert.deepEqual(derived.channels.map(({ name, group }) => [name, group]), [
    ["pressure1_bar", "pressure"], ["pressure2_bar", "pressure"],
    ["reference_pressure_difference_bar", "difference"], ["pressure_difference_bar", "difference"],
  ]);
  const column = (...last) => ({ min: last, max: last, last });
  const bytes = frame(1, [0, 0.01], [column(3, NaN), column(1.5, 1), column(1, 1)]);
  const buckets = derived.add(decodeBuckets(bytes, 3));
  assert.equal(buckets.channels.length, 4);
  assert.deepEqual([...buckets.channels[3].last], [1.5, NaN]);
});

test("without such a reference nothing is added", () => {
  const derived = new Derived(PRESSURES);
  assert.deepEqual(derived.channels, PRESSURES);
  const buckets = decodeBuckets(frame(1, [0], PRESSURES.map(() => ({ min: [1], max: [1], last: [1] }))), 2);
  assert.equal(derived.add(buckets), buckets);
});
