// Calibrations guided by the page, on the simulated bench of the rehearsals: by the camera alone,
// and by a target that is put before it, looked for, captured and measured.

import assert from "node:assert/strict";
import { access, readdir } from "node:fs/promises";
import path from "node:path";
import { after, afterEach, before, test } from "node:test";
import { closePages, openPage, press, startBrowser, startConsole, textOf, until, violations, workplace } from "./bench.mjs";

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

const records = async (kind) => (await readdir(path.join(place.folder, "calibration/rehearsal", kind)).catch(() => [])).filter((name) => name.endsWith(".toml"));

test("the sensor and the lens are calibrated by the page alone", async () => {
  const page = await openPage(browser, desk.address, "#calibrate");
  await press(page, "#rehearse");
  await until(page, "the bench of the rehearsals is in use", () => document.querySelector("#rig-name").textContent === "rehearsal");

  // By the camera alone: discarded, then accepted.
  await page.evaluate(() => (location.hash = "#calibrate/sensor"));
  await press(page, "#guide-start");
  await until(page, "the gain is shown", () => document.querySelector("#guide-said").innerText.includes("gain 0.3"));
  assert.deepEqual(await records("sensor"), [], "a record was in force before it was accepted");
  await press(page, "#guide-repeat");
  await press(page, "#guide-start");
  await until(page, "the figure is shown", () => document.querySelector("#guide-result img")?.naturalWidth > 0);
  assert.deepEqual(await violations(page), []);
  await press(page, "#guide-accept");
  await until(page, "the list has it", () => [...document.querySelectorAll(".calibrations li")].some((one) => one.innerText.startsWith("Sensor ok")));
  assert.equal((await records("sensor")).length, 1);

  // By a target. The page stays where it is when the simulated bench gets it.
  await page.evaluate(() => (location.hash = "#calibrate/camera"));
  await page.evaluate(() => (globalThis.stays = true));
  await press(page, "#put-target");
  for (const step of ["Show the live picture", "Home the stage", "Aim the light", "Lamp on"]) {
    await until(page, step, (wanted) => document.querySelector("#guide-light").innerText === wanted && !document.querySelector("#guide-light").disabled, step);
    await press(page, "#guide-light");
  }
  await until(page, "the board is seen", () => {
    const seen = document.querySelector("#target-seen").innerText;
    if (seen !== "Looking …" && !seen.startsWith("Yes")) document.querySelector("#check-target").click();
    return seen.startsWith("Yes");
  });
  assert.match(await textOf(page, "#target-seen"), /the whole board, 63 corners/);

  // STOP under the page's lamp, then under that of the capture, which goes on where it was.
  const stopped = async (text) => {
    await page.click("#stop");
    await until(page, `STOP says ${text}`, (wanted) => document.querySelector(".notice.answer")?.innerText.includes(wanted), text);
    await page.click(".notice.answer button");
  };
  await stopped("STOP: the stage stands, the lamp is off.");
  await press(page, "#guide-start");
  await until(page, "the target is being captured", () => document.querySelector("#guide-progress progress").value > 0 && document.querySelector("#guide-progress").checkVisibility());
  await stopped("STOP ended a capture, its lamp was switched off.");
  await until(page, "it says how to go on", () => document.querySelector("#view-calibrate .stack-form .error").innerText.includes("“Resume it” goes on where it was."));
  assert.deepEqual(await violations(page), []);
  await press(page, "#guide-resume");
  await until(page, "the corners are counted", () => /views: 1, corners: 63/.test(document.querySelector("#guide-said").innerText));
  await press(page, "#guide-accept");
  await until(page, "the list is shown", () => location.hash === "#calibrate");
  assert.ok(await page.evaluate(() => globalThis.stays), "the page was loaded anew");
  await stopped("Nothing was running. The bench is not connected to this console");
  assert.equal((await records("camera")).length, 1);
  await access(path.join(place.folder, "calibration/rehearsal/plots", (await records("camera"))[0].replace("toml", "png")));
  assert.deepEqual(page.complaints, []);
});
