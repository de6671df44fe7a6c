// Every view: accessible, within a phone's width, used by the keyboard alone, and shared by
// two pages of which one controls.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";
import { LAPTOP, PHONE, closePages, openPage, press, startBrowser, startConsole, textOf, until, untilCapture, violations, workplace } from "./bench.mjs";

const VIEWS = ["#bench", "#calibrate", "#capture", "#queue", "#sessions", "#setup"];

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

async function inReach(page) {
  return page.evaluate(() => {
    const { top, bottom, left, right } = document.querySelector("#stop").getBoundingClientRect();
    const hit = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    return top >= 0 && left >= 0 && bottom <= innerHeight && right <= innerWidth && hit?.id === "stop";
  });
}

test("no view has a violation of accessibility, scrolls sideways or hides STOP", async () => {
  const page = await openPage(browser, desk.address, "#bench");
  await press(page, "#view-bench .devices button");
  await until(page, "the live picture is shown", () => document.querySelector("#view-bench .picture img.there"));
  for (const size of [LAPTOP, PHONE]) {
    await page.setViewport(size);
    for (const view of VIEWS) {
      await page.evaluate((hash) => (location.hash = hash), view);
      await until(page, `${view} is filled`, (hash) => [...document.querySelectorAll(`#view-${hash.slice(1)} .panel`)].some((panel) => panel.checkVisibility()), view);
      await until(page, "nothing is being loaded", () => ![...document.querySelectorAll(".loaded")].some((part) => part.innerText.includes("Checking")));
      for (const theme of ["light", "dark"]) {
        await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: theme }]);
        assert.deepEqual(await violations(page), [], `${view} at ${size.width} px, ${theme}`);
      }
      assert.equal(await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth), 0, `${view} at ${size.width} px scrolls sideways`);
      await page.evaluate(() => window.scrollTo(0, document.body.scrollHeight));
      assert.ok(await inReach(page), `${view} at ${size.width} px: STOP is out of reach`);
    }
  }
  assert.deepEqual(page.complaints, []);
});

test("of two pages one controls, and the other takes it over", async () => {
  const first = await openPage(browser, desk.address, "#bench");
  const second = await openPage(browser, desk.address, "#bench");
  await press(first, "#take");
  await until(second, "the second page is told", () => document.querySelector("#control-text").textContent.startsWith("Another page controls"));
  assert.match(await textOf(second, "#view-bench .why"), /Another page controls the bench/);
  assert.ok(await second.$eval("#view-bench .devices button", (button) => button.disabled));
  assert.ok(await second.$eval("#stop", (button) => !button.disabled));
  await press(second, "#take");
  await until(first, "the first page has lost it", () => document.querySelector("#control-text").textContent.startsWith("Another page controls"));
  assert.ok(await first.$eval("#view-bench .devices button", (button) => button.disabled));
  await until(second, "the second page may act", () => !document.querySelector("#view-bench .devices button").disabled);
  await press(second, "#take");
  await until(first, "nobody controls", () => document.querySelector("#control-text").textContent.startsWith("Nobody controls"));
  assert.deepEqual([...first.complaints, ...second.complaints], []);
});

test("the stage is moved and lit by the page", async () => {
  const page = await openPage(browser, desk.address, "#bench");
  await until(page, "the state is known", () => document.querySelector("#view-bench .devices p").textContent !== "");
  if ((await textOf(page, "#view-bench .devices button")) === "Connect") await press(page, "#view-bench .devices button");
  const button = (name) => page.evaluateHandle((text) => [...document.querySelectorAll("#view-bench button")].find((one) => one.textContent === text), name);
  const enabled = (name) => until(page, `${name} can be pressed`, (text) => [...document.querySelectorAll("#view-bench button")].some((one) => one.textContent === text && !one.disabled), name);
  await enabled("Home");
  await (await button("Home")).evaluate((element) => element.click());
  await enabled("Move");
  // The hemisphere by the keyboard: from its first aim, azimuth 0° and elevation 60°, 5° up.
  await page.$eval("#view-bench .hemisphere", (map) => map.focus());
  await page.keyboard.press("ArrowUp");
  await page.keyboard.press("Enter");
  await until(page, "the stage has moved", () => [...document.querySelectorAll("#view-bench dd")].some((one) => one.textContent === "azimuth 0°, elevation 65°"));
  await enabled("red");
  await (await button("red")).evaluate((element) => element.click());
  await until(page, "the lamp is on", () => document.querySelector('#view-bench [aria-pressed="true"].toggle') && document.querySelector("#view-bench").innerText.includes("On: red"));
  await press(page, "#stop");
  await until(page, "STOP has put the lamp out", () => document.querySelector("#view-bench").innerText.includes("Off."));
  const told = (what) => until(page, what, (wanted) => document.querySelector(".notice.answer")?.innerText.includes(wanted), what);
  await told("STOP: the stage stands, the lamp is off.");
  // What this console does not hold it cannot stop, and the page says so.
  await enabled("Disconnect");
  await (await button("Disconnect")).evaluate((element) => element.click());
  await enabled("Connect");
  await press(page, "#stop");
  await told("Nothing was running. The bench is not connected to this console");
  assert.deepEqual(page.complaints, []);
});

test("the keyboard alone starts a capture and stops it", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  await until(page, "the form is there", () => document.querySelector("#sample")?.checkVisibility());
  const tabTo = async (id) => {
    for (let presses = 0; presses < 60; presses += 1) {
      if (await page.evaluate((wanted) => document.activeElement?.id === wanted, id)) return;
      await page.keyboard.press("Tab");
    }
    assert.fail(`Tab does not reach ${id}`);
  };
  await tabTo("sample");
  await page.keyboard.type("keys");
  await until(page, "the capture can be started", () => !document.querySelector("#start").disabled);
  await tabTo("start");
  await page.keyboard.press("Enter");
  await untilCapture(page, "homing", "moving", "exposing");
  await page.evaluate(() => document.activeElement?.blur());
  await tabTo("stop");
  await page.keyboard.press("Enter");
  await untilCapture(page, "interrupted");
  assert.deepEqual(page.complaints, []);
});

test("keys lead to the views, are listed, can be turned off, and stop", async () => {
  const page = await openPage(browser, desk.address, "#bench");
  const view = (name) => until(page, `${name} is shown`, (id) => document.querySelector(`#view-${id}`).checkVisibility(), name);
  await page.keyboard.press("s");
  await view("sessions");
  await page.keyboard.press("/");
  await until(page, "the search has the focus", () => document.activeElement?.id === "search");
  await page.keyboard.type("b?");
  assert.equal(await page.$eval("#search", (input) => input.value), "b?");
  await page.$eval("#search", (input) => input.blur());
  await page.keyboard.type("?");
  await until(page, "the keys are listed", () => document.querySelector("dialog").open);
  assert.match(await textOf(page, "dialog"), /Search the sessions[\s\S]*STOP/);
  assert.deepEqual(await violations(page), []);
  assert.ok(await inReach(page));
  await page.$eval("#keys-on", (box) => box.click());
  await page.keyboard.press("Escape");
  await page.keyboard.press("b");
  assert.ok(await page.$eval("#view-sessions", (shown) => shown.checkVisibility()), "single keys are off");
  await page.keyboard.down("Shift");
  await page.keyboard.press("Escape");
  await page.keyboard.up("Shift");
  await until(page, "STOP was sent", () => document.querySelector("#spoken").textContent.startsWith("STOP"));
  await page.evaluate(() => localStorage.removeItem("rig-keys"));
  assert.deepEqual(page.complaints, []);
});
