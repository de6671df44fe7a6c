// A day at the bench: samples in a queue, a lamp that is held by hand, another bench.

import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import path from "node:path";
import { after, afterEach, before, test } from "node:test";
import { PHONE, closePages, openPage, press, startBrowser, startConsole, textOf, until, untilCapture, violations, workplace } from "./bench.mjs";

/** The small bench with a person in place of its stage. */
const BY_HAND = `[stage]
driver = "manual"
[[stage.light]]
azimuth_deg = 0.0
elevation_deg = 60.0
[[stage.light]]
azimuth_deg = 120.0
elevation_deg = 60.0
[[stage.lamp]]
measures = "R"
channel = 0
[[stage.lamp]]
measures = "G"
channel = 1
[[stage.lamp]]
measures = "B"
channel = 2

`;

let place, desk, browser;
before(async () => {
  place = await workplace({ timing: "instant" });
  const text = await readFile(path.join(place.folder, "rig.toml"), "utf8");
  await writeFile(path.join(place.folder, "torch.toml"), text.replace(/\[stage\][\s\S]*?(?=# -+ geometry)/, BY_HAND));
  [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);
});
afterEach(() => closePages(browser));
after(async () => {
  await browser?.close();
  await desk?.stop();
  await place?.remove();
});

const list = (page) => textOf(page, ".queue");
const listed = (page, what, wanted) => until(page, what, (text) => document.querySelector(".queue").innerText.includes(text), wanted);
const stepped = (page, wanted) => until(page, `the queue says ${wanted}`, (text) => document.querySelector("#view-queue .next .big").innerText.includes(text), wanted);

test("a queue of three on a phone: one skipped and brought back, one repeated", async () => {
  const page = await openPage(browser, desk.address, "#queue", PHONE);
  await page.$eval("#queue-lights", (input) => (input.value = "1"));
  await page.$eval("#queue-fit", (input) => input.click());
  // A scanner types and presses Enter; the others come from a table.
  await page.focus("#queue-add");
  await page.keyboard.type("cup\n");
  await listed(page, "the scanned sample is listed", "cup");
  await page.keyboard.type("c p\n");
  await until(page, "a bad name is refused", () => document.querySelector("#view-queue .error").innerText.includes("no name of a sample"));
  const table = path.join(place.folder, "day.csv");
  await writeFile(table, "name;material;repeats\nbowl;red paint;1\njar;;1\n");
  await (await page.$("#queue-file")).uploadFile(table);
  await listed(page, "the table is listed", "jar");

  await stepped(page, "cup");
  await press(page, "#queue-next");
  await stepped(page, "bowl");
  assert.match(await list(page), /cup session captured/);
  await press(page, "#queue-skip");
  await page.type("#queue-reason", "cracked");
  await press(page, "#queue-skip-sure");
  await stepped(page, "jar");
  assert.match(await list(page), /bowl left out cracked/);
  await press(page, "#queue-repeat");
  await stepped(page, "Take off and put back: cup (2 of 2)");
  await press(page, "#queue-next");
  await stepped(page, "jar");
  // Until an error that the first light's fit reaches.
  await page.type("#queue-until", "100");
  await press(page, "#queue-next");
  await stepped(page, "All samples are done");
  await page.$eval("#queue-until", (input) => (input.value = ""));
  await page.evaluate(() => (location.hash = "#capture"));
  await until(page, "it says why no light follows", () => /Last decision\s+Expected environment error .* no light follows/.test(document.querySelector("#view-capture").innerText));
  await page.evaluate(() => (location.hash = "#queue"));
  for (const theme of ["light", "dark"]) {
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: theme }]);
    assert.deepEqual(await violations(page), []);
  }
  await page.evaluate(() => document.querySelector('[aria-label="Bring back bowl"]').click());
  await stepped(page, "bowl");
  await press(page, "#queue-next");
  await stepped(page, "All samples are done");
  assert.doesNotMatch(await list(page), /left out|to do/);
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth), 0);
  assert.deepEqual(page.complaints, []);
});

test("a bench is edited and chosen, and its lamp held by hand; STOP ends a question", async () => {
  const page = await openPage(browser, desk.address, "#setup");
  await until(page, "the benches are listed", () => document.querySelector('[aria-label="Edit torch.toml"]'));
  await page.evaluate(() => document.querySelector('[aria-label="Edit torch.toml"]').click());
  await until(page, "its text is there", () => document.querySelector("#rig-text").value.length > 100);
  await page.$eval("#rig-text", (text) => (text.value = text.value.replace('name = "simulated"', "name = 3")));
  await press(page, "#save-rig");
  await until(page, "the mistake is named", () => [...document.querySelectorAll("#view-setup .error")].some((one) => one.innerText.includes("rig.name")));
  await page.$eval("#rig-text", (text) => (text.value = text.value.replace("name = 3", 'name = "simulated" # by hand')));
  await press(page, "#save-use-rig");
  await until(page, "the page works with it", () => document.querySelector("#link").dataset.kind === "live" && document.querySelector(".benches [aria-current]")?.innerText.includes("torch.toml"));
  await press(page, "#try-frame");
  await until(page, "a frame is shown", () => document.querySelector("#tried").innerText.startsWith("A frame of 64") && document.querySelector("img.tried").naturalWidth === 64);

  await page.evaluate(() => (location.hash = "#capture"));
  await until(page, "the form is there", () => document.querySelector("#sample")?.checkVisibility());
  await page.type("#sample", "held");
  await page.$eval("#lights", (input) => (input.value = "2"));
  await page.$eval("#fit", (input) => input.checked && input.click());
  await page.$eval("#lights", (input) => input.dispatchEvent(new Event("input", { bubbles: true })));
  await press(page, "#start");
  const asked = (wanted) => until(page, `asked to: ${wanted}`, (text) => document.querySelector("#hands")?.checkVisibility() && document.querySelector("#hands .big").innerText.includes(text), wanted);
  await asked("Switch the lamp off");
  assert.deepEqual(await violations(page), []);
  await press(page, "#hand-done");
  await asked("Hold the lamp at azimuth 0°, elevation 60°");
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Space");
  await asked("Switch the lamp on: red alone");
  await page.keyboard.press("Space");
  await asked("Switch the lamp on: green alone");
  await page.evaluate(() => document.querySelector("#stop").click());
  await untilCapture(page, "interrupted", "failed");
  assert.ok(await page.evaluate(() => !document.querySelector("#hands").checkVisibility()));
  await press(page, "#resume-only");
  // "Stop after this frame" waits for nobody's hands.
  await asked("");
  await press(page, "#finish");
  await untilCapture(page, "interrupted");
  await press(page, "#resume-only");
  // Every request is confirmed until the end.
  const done = setInterval(() => page.evaluate(() => document.querySelector("#hands")?.checkVisibility() && document.querySelector("#hand-done").click()).catch(() => {}), 50);
  await untilCapture(page, "complete");
  clearInterval(done);
});
