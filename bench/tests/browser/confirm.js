// People at the rig answer in the browser: a request, a request for an amount.

import assert from "node:assert/strict";
import { browser, given, says, visit, word } from "./session.js";

const chrome = await browser();
const { page, faults } = await visit(chrome, given("MONITOR_ADDRESS"));
await word(page, /^IDLE$/);
assert.equal(await page.isVisible("#confirm"), false);
await page.selectOption("#profile", given("MONITOR_PROFILE"));
await page.click("#arm");
await page.click("#enqueue");

const asked = [];
while (!asked.at(-1)?.includes("Weigh")) {
  const before = asked.at(-1) ?? "";
  await page.waitForFunction((text) => {
    const shown = document.getElementById("confirm-text").textContent;
    return !document.getElementById("confirm").hidden && shown !== text;
  }, before);
  await word(page, /^WAITING$/);
  asked.push(await page.textContent("#confirm-text"));
  console.log(`asked: ${asked.at(-1)}`);
  assert.equal(await page.isVisible("#confirm-volume"), asked.at(-1).includes("Weigh"), "a field where an amount is asked for");
  if (asked.at(-1).includes("Weigh")) break;
  // A press within 0.3 s of a new request is not taken for its answer.
  await page.waitForTimeout(400);
  await page.click("#confirm-done");
}

await page.waitForTimeout(400);
await page.click("#confirm-done");
await says(page, "#confirm-answer", /\S/);
console.log(`without the amount: ${await page.textContent("#confirm-answer")}`);
assert.ok(await page.isVisible("#confirm"), "it still waits");
await page.fill("#confirm-volume", "1.25");
await page.keyboard.press("Enter");
await page.waitForFunction(() => document.getElementById("confirm").hidden);
await says(page, "#run-name", /completed/);
// The amount is the measured volume of the tick that took it.
const volume_ml = await page.evaluate(() => {
  const { plots, history } = globalThis.recBench;
  const { max } = history.fine.columns[plots.channels.findIndex(({ name }) => name === "volume_ml")];
  return Math.max(...max.filter((value) => !Number.isNaN(value)));
});
assert.equal(volume_ml, 1.25);
assert.ok(asked.length >= 2, `asked: ${asked}`);
assert.deepEqual(faults, []);
await chrome.close();
console.log("all seen");
