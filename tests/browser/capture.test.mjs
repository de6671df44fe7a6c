// Captures from the page: from the form to the report, and every way to halt one.

import assert from "node:assert/strict";
import { access } from "node:fs/promises";
import path from "node:path";
import { after, afterEach, before, test } from "node:test";
import { closePages, openPage, press, rig, sessionOf, startBrowser, startCapture, startConsole, textOf, until, untilCapture, workplace } from "./bench.mjs";

let place, desk, browser;
before(async () => {
  place = await workplace();
  [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);
});
afterEach(() => closePages(browser));
after(async () => {
  await browser?.close();
  await desk?.stop();
  await place?.remove();
});

async function isWhole(folder, session) {
  await rig(folder, "session", "verify", session);
}

test("a capture goes from the form to the report", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  await until(page, "the plan is drawn", () => document.querySelectorAll("#view-capture .light").length > 0);
  await startCapture(page, { sample: "form", lights: 1, fit: true });
  await untilCapture(page, "exposing");
  await until(page, "the last frame is shown", () => document.querySelector(".picture img.there")?.checkVisibility());
  await until(page, "the table has the light that is captured now", () => document.querySelector(".lights tr.now"));
  await untilCapture(page, "complete");
  assert.match(await textOf(page, "#view-capture"), /1 of 1 done/);
  await press(page, "#open-session");
  await until(page, "the verdict is shown", () => document.querySelector("#view-sessions .verdict .badge")?.checkVisibility());
  assert.match(await textOf(page, "#view-sessions .verdict"), /The fit/);
  const report = await page.$eval("#report", (link) => link.href);
  const opened = await browser.newPage();
  const answer = await opened.goto(report);
  assert.equal(answer.status(), 200);
  assert.match(answer.headers()["content-security-policy"], /sandbox/);
  assert.match(await opened.evaluate(() => document.body.innerText), /form/);
  await isWhole(place.folder, await sessionOf(place.folder, "form"));
  assert.deepEqual(page.complaints, []);
});

test("paused, reloaded and continued, a capture ends whole", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  await startCapture(page, { sample: "paused", lights: 2 });
  await untilCapture(page, "exposing");
  await press(page, "#pause");
  await untilCapture(page, "paused");
  await page.reload();
  await until(page, "the page is live again", () => document.querySelector("#link").dataset.kind === "live");
  await untilCapture(page, "paused");
  assert.match(await textOf(page, "#control-text"), /This page controls/);
  await press(page, "#continue");
  await untilCapture(page, "complete");
  await isWhole(place.folder, await sessionOf(place.folder, "paused"));
  assert.deepEqual(page.complaints, []);
});

test("stopped after a frame, a capture is resumed to its end", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  await startCapture(page, { sample: "finished", lights: 1 });
  await untilCapture(page, "exposing");
  await press(page, "#finish");
  await untilCapture(page, "interrupted");
  await press(page, "#resume-only");
  await untilCapture(page, "complete");
  await isWhole(place.folder, await sessionOf(place.folder, "finished"));
  assert.deepEqual(page.complaints, []);
});

test("STOP ends a capture from a page that does not control", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  await startCapture(page, { sample: "stopped", lights: 2 });
  await untilCapture(page, "exposing");
  const other = await openPage(browser, desk.address, "#sessions");
  await press(other, "#stop");
  await untilCapture(page, "interrupted");
  const session = await sessionOf(place.folder, "stopped");
  await access(path.join(session, "journal.jsonl"));
  await isWhole(place.folder, session).catch((error) => assert.match(error.stderr, /not complete|incomplete|resume/));
  assert.deepEqual([...page.complaints, ...other.complaints], []);
});
