// What a capture has led to: found again, fitted again, compared and exported.

import assert from "node:assert/strict";
import path from "node:path";
import { after, before, test } from "node:test";
import { PHONE, openPage, press, rig, sessionOf, startBrowser, startConsole, until, violations, workplace } from "./bench.mjs";

let place, desk, browser, name;
before(async () => {
  place = await workplace({ timing: "instant" });
  await rig(place.folder, "capture", "--rig", "rig.toml", "--sample", "cup", "--lights", "1", "--quiet");
  await rig(place.folder, "capture", "--rig", "rig.toml", "--sample", "plate", "--lights", "1", "--no-fit", "--quiet");
  name = path.basename(await sessionOf(place.folder, "cup"));
  [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);
});
after(async () => {
  await browser?.close();
  await desk?.stop();
  await place?.remove();
});

test("a session is found, fitted again, compared and exported", async () => {
  const page = await openPage(browser, desk.address, "#sessions");
  const cards = () => page.$$eval("#view-sessions .card", (all) => all.map((card) => card.innerText));
  await until(page, "both sessions are listed", () => document.querySelectorAll("#view-sessions .card").length === 2);
  await until(page, "each has its thumbnail", () => [...document.querySelectorAll("#view-sessions .thumbnail img")].filter((img) => img.naturalWidth > 0).length === 2);
  assert.match((await cards())[0], /plate/, "the newest is first");
  await page.select("#sort", "sample");
  assert.match((await cards())[0], /cup/, "sorted by sample");
  assert.deepEqual(await violations(page), []);
  await page.type("#search", "cup");
  await until(page, "one is found", () => document.querySelectorAll("#view-sessions .card").length === 1);
  assert.match((await cards())[0], /cup/);

  // Fitted again with another dictionary.
  await page.evaluate((hash) => (location.hash = hash), `#sessions/${name}`);
  await until(page, "its fit is shown", () => document.querySelectorAll("#view-sessions .fit").length === 1);
  assert.deepEqual(await violations(page), []);
  await page.select("#dictionary", "paper42");
  await press(page, "#fit-again");
  await until(page, "the fit's progress is shown", () => document.querySelector("#stop-job").checkVisibility());
  await until(page, "the second fit is shown", () => document.querySelectorAll("#view-sessions .fit").length === 2);
  await until(page, "the report is of the second fit", () => document.querySelector("#report").textContent === "Open the report of fit 1");
  const report = await page.evaluate(async () => (await fetch(document.querySelector("#report").href)).text());
  assert.match(report, /dictionary paper42 · fit 1/);
  assert.match(await page.title(), /^[✓!✗] .* · simulated – rig console$/);
  await until(page, "its pictures are loaded", () => [...document.querySelectorAll("#view-sessions .fit[open] img")].some((img) => img.naturalWidth > 0));

  // Exported.
  await page.select("#export-format", "merl");
  await press(page, "#export");
  await until(page, "the file is offered", () => document.querySelector("#download").checkVisibility());
  const file = await page.evaluate(async () => {
    const answer = await fetch(document.querySelector("#download").href);
    return { status: answer.status, kind: answer.headers.get("content-disposition"), bytes: (await answer.arrayBuffer()).byteLength };
  });
  // MERL: three sizes and 3 x 90 x 90 x 180 doubles.
  assert.deepEqual([file.status, file.bytes], [200, 12 + 3 * 90 * 90 * 180 * 8]);
  assert.match(file.kind, /attachment/);

  // As another program's material: its error and its picture.
  await page.select("#export-format", "gltf");
  await press(page, "#export");
  await until(page, "the picture is shown", () => [...document.querySelectorAll(".work .gallery img")].some((img) => img.naturalWidth > 0));
  assert.match(await page.$eval("#said", (list) => list.innerText), /environment error/);
  assert.deepEqual(await violations(page), []);

  // Its certificate, or why there is none.
  const trusted = await page.$eval("#export-fit", (select) => select.value) && !(await page.$eval("#certificate", (button) => button.disabled));
  if (trusted) {
    await press(page, "#certificate");
    await until(page, "the certificate is offered", () => document.querySelector("#download").checkVisibility() && document.querySelector("#download").textContent.includes("certificate"));
    const certificate = await page.evaluate(async () => (await fetch(document.querySelector("#download").href)).text());
    assert.equal(certificate.match(/\/Type \/Page\b/g).length, 2, "pages of the certificate");
  } else {
    assert.match(await page.$eval("#certificate", (button) => button.title), /trusted/);
  }

  // A session that has no fit offers no export.
  await page.evaluate((hash) => (location.hash = hash), `#sessions/${path.basename(await sessionOf(place.folder, "plate"))}`);
  await until(page, "it is not fitted", () => document.querySelector("#view-sessions .verdict")?.innerText.includes("no fit") && document.querySelector("#fit-again").textContent === "Fit");
  assert.equal(await page.$eval("#export", (button) => button.checkVisibility()), false);

  // Side by side.
  await page.evaluate((hash) => (location.hash = hash), `#sessions/compare/${encodeURIComponent(`${name}:0`)}/${encodeURIComponent(`${name}:1`)}`);
  await until(page, "both fits are shown", () => [...document.querySelectorAll(".compare-pictures .pair")].some((pair) => [...pair.querySelectorAll("img")].filter((img) => img.naturalWidth > 0).length === 2));
  const dictionaries = await page.$$eval("section[aria-label='Fit A'], section[aria-label='Fit B']", (sides) => sides.map((side) => side.innerText.match(/Dictionary\s+(\S+)/)?.[1]));
  assert.deepEqual(dictionaries, ["rig65", "paper42"]);
  await until(page, "they are measured against each other", () => /B against A\s+[\d.]+%\s+[\d.]+ standard/.test(document.querySelector("#apart").innerText));
  assert.equal(await page.$$eval("#curves svg", (all) => all.map((svg) => svg.querySelectorAll(".line, .band").length).join()), "4,4,4");
  await press(page, "#add-fit");
  await until(page, "the third fit is measured against both", () => document.querySelectorAll("#apart tbody tr").length === 3);
  await press(page, "section[aria-label='Fit C'] .quiet");
  await until(page, "it is left out again", () => document.querySelectorAll("#apart tbody tr").length === 1);
  assert.deepEqual(await violations(page), []);
  // A phone's viewport loads the page anew.
  await page.setViewport(PHONE);
  await until(page, "both fits are shown on a phone", () => ["Fit A", "Fit B"].every((label) => document.querySelector(`section[aria-label='${label}']`)?.innerText.includes("χ²")));
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth), 0, "the comparison scrolls sideways");
  assert.deepEqual(page.complaints, []);
});
