// A read-only service beside a run of another process: everything is shown, nothing can be ordered, and the page says how that changes.

import assert from "node:assert/strict";
import { browser, given, says, until, visit, word } from "./session.js";

const chrome = await browser();
const { page, faults } = await visit(chrome, given("MONITOR_ADDRESS"));
await word(page, /^FOLLOWING$/);
await says(page, "#run-name", /^to_be_watched$/);
await says(page, "#run-facts", /of another process/);
await until(page, 3);
await says(page, '[data-channel="angle_deg"] .tile-value', /\d\.\d\d/);
await says(page, "#control-read-only", /bench serve --control/);
assert.ok(await page.isVisible("#control-read-only"));
for (const hidden of ["#controls", "#token-form", "#stop", "#emergency-stop", "#acknowledge"]) {
  assert.equal(await page.isVisible(hidden), false, `${hidden} is hidden`);
}
assert.ok(await page.isVisible("#read-only"));
assert.deepEqual(faults, []);
await chrome.close();
console.log("all seen");
