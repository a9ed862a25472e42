// A browser at the monitor's page: opening it, and what the tests ask it for.

import { createRequire } from "node:module";
import assert from "node:assert/strict";
import process from "node:process";

/** @param {string} name of an environment variable that the Rust test sets */
export function given(name) {
  const value = process.env[name];
  assert.ok(value, `expected the environment variable ${name}; run this by cargo test --release -p bench --test web_monitor`);
  return value;
}

// The packages lie below the target directory, not beside the scripts.
const { chromium } = createRequire(`${given("MONITOR_PACKAGES")}/`)("playwright-core");

const FLAGS = [
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
];
/** Nothing takes so long; the machine may be slow. */
export const PATIENCE_MS = 90_000;

/** A browser with a profile of its own, which goes with it. */
export async function browser() {
  return chromium.launch({ executablePath: given("MONITOR_CHROMIUM"), args: FLAGS, timeout: PATIENCE_MS });
}

export const DESKTOP = { viewport: { width: 1400, height: 1000 } };
export const PHONE = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true };

/**
 * The page in a context of its own. `faults` collects what no visit may have: errors of scripts, what the content policy refused, and requests to
 * anything but the service.
 */
export async function visit(chrome, address, context = DESKTOP) {
  const page = await (await chrome.newContext(context)).newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  const faults = [];
  const origin = new URL(address).origin;
  page.on("pageerror", (error) => faults.push(`script: ${error}`));
  // The browser itself notes requests that fail while the service is away, and commands that it refuses.
  page.on("console", (message) => message.type() === "error" && !/Failed to load resource|WebSocket connection/.test(message.text()) && faults.push(message.text()));
  page.on("request", (request) => {
    const url = request.url();
    if (!url.startsWith(origin) && !/^(data|blob):/.test(url)) faults.push(`a request to ${url}`);
  });
  await page.goto(address);
  return { page, faults };
}

/** Waits until the text of an element matches. */
export async function says(page, selector, pattern) {
  const source = pattern.source;
  try {
    await page.waitForFunction(([s, p]) => new RegExp(p).test(document.querySelector(s)?.textContent ?? ""), [selector, source]);
  } catch (error) {
    const text = await page.textContent(selector);
    throw new Error(`${selector}: expected ${pattern}, got ${JSON.stringify(text)} (${error.message.split("\n")[0]})`);
  }
}

export const word = (page, pattern) => says(page, "#state-word", pattern);

/** Newest second of the run on screen. */
export const drawnTo = (page) => page.evaluate(() => globalThis.recBench.plots.view.to_s);

/** Waits until the curves have come to this second of the run. */
export const until = (page, time_s) => page.waitForFunction((t) => globalThis.recBench.plots.view.to_s >= t, time_s);

/** No part of the page lies beside the screen. */
export async function fits(page) {
  const { needed, there } = await page.evaluate(() => ({ needed: document.documentElement.scrollWidth, there: document.documentElement.clientWidth }));
  assert.ok(needed <= there, `the page is ${needed} px wide on a screen of ${there}`);
}

/** The whole element is on screen. */
export async function onScreen(page, selector) {
  const inside = await page.$eval(selector, (element) => {
    const box = element.getBoundingClientRect();
    const top = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
    return box.width > 0 && box.top >= 0 && box.left >= 0 && box.bottom <= innerHeight && box.right <= innerWidth && element.contains(top);
  });
  assert.ok(inside, `${selector} is not on screen, or something lies over it`);
}

/** Waits for the next change of the banner and says how long after `since` (ms since 1970) the page made it. */
export async function bannerAfter(page, shown, action) {
  const seen = page.evaluate((wanted) => new Promise((resolve) => {
    const banner = document.getElementById("lost");
    const look = () => banner.hidden !== wanted && resolve(Date.now());
    new MutationObserver(look).observe(banner, { attributes: true });
    look();
  }), shown);
  // The observer is in place once the page answers something that was asked after it.
  await page.evaluate(() => 0);
  const since = Date.now();
  await action();
  return (await seen) - since;
}

/** Median and 95th percentile. */
export function percentiles(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
  return { n: sorted.length, p50: at(0.5), p95: at(0.95), max: sorted.at(-1) };
}
