// A read-only service: everything is shown, nothing can be ordered, and the page says how that changes.

import assert from "node:assert/strict";
import { browser, given, says, visit, word } from "./session.js";

const chrome = await browser();
const { page, faults } = await visit(chrome, given("MONITOR_ADDRESS"));
await word(page, /^IDLE$/);
await says(page, "#control-read-only", /bench serve --control/);
assert.ok(await page.isVisible("#control-read-only"));
for (const hidden of ["#controls", "#token-form", "#stop", "#emergency-stop", "#acknowledge"]) {
  assert.equal(await page.isVisible(hidden), false, `${hidden} is hidden`);
}
assert.ok(await page.isVisible("#read-only"));
assert.deepEqual(faults, []);
await chrome.close();
console.log("all seen");
