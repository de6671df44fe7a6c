// Screenshots for docs/console.md: pictures.mjs FOLDER

import { statSync } from "node:fs";
import path from "node:path";
import { LAPTOP, PHONE, openPage, press, startBrowser, startCapture, startConsole, until, untilCapture, workplace } from "./bench.mjs";

const MOST_BYTES = 200e3;
const folder = process.argv[2];
const place = await workplace({ small: false });
const [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);

/** A PNG of the window, checked against the size that the documentation allows. */
async function shoot(page, name, about = {}) {
  const file = path.join(folder, `console-${name}.png`);
  await page.screenshot({ path: file, ...about });
  const { size } = statSync(file);
  if (size > MOST_BYTES) throw new Error(`${file} has ${size} bytes, more than ${MOST_BYTES}`);
  console.log(`${file}: ${size} bytes`);
}

try {
  const page = await openPage(browser, desk.address, "#bench", { ...LAPTOP, height: 1000 });
  await press(page, "#view-bench .devices button");
  await until(page, "the stage can be homed", () => [...document.querySelectorAll("#view-bench button")].some((one) => one.textContent === "Home" && !one.disabled));
  const click = (text) => page.evaluate((wanted) => [...document.querySelectorAll("#view-bench button")].find((one) => one.textContent === wanted).click(), text);
  const enabled = (text) => until(page, `${text} can be pressed`, (wanted) => [...document.querySelectorAll("#view-bench button")].some((one) => one.textContent === wanted && !one.disabled), text);
  await click("Home");
  await enabled("Move");
  await page.$eval("#view-bench .hemisphere", (map) => map.focus());
  for (const key of ["ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowLeft", "Enter"]) await page.keyboard.press(key);
  await until(page, "the stage moves", () => [...document.querySelectorAll("#view-bench dd")].some((one) => one.textContent === "azimuth 30°, elevation 60°"));
  await enabled("green");
  await click("green");
  await until(page, "the lamp is on", () => document.querySelector("#view-bench").innerText.includes("On: green"));
  await page.evaluate(() => document.activeElement.blur());
  // The simulated bench renders the light's new direction first.
  await until(page, "the lit sample is shown", () => Number(document.querySelector("#view-bench .two").innerText.match(/mean (\d+)/)?.[1]) > 150 && !document.querySelector("#view-bench .picture").classList.contains("stale"));
  await new Promise((resolve) => setTimeout(resolve, 1500));
  await shoot(page, "bench");

  await startCapture(page, { sample: "red-paint", lights: 4, fit: true });
  await until(page, "the second light is captured", () => document.querySelector('.lights tr:nth-child(2)')?.classList.contains("now") && document.querySelector(".picture img.there"));
  await new Promise((resolve) => setTimeout(resolve, 2500));
  await shoot(page, "during");
  const phone = await openPage(browser, desk.address, "#capture", { ...PHONE, deviceScaleFactor: 1 });
  await until(phone, "the last frame is shown", () => document.querySelector("#view-capture .picture img.there"));
  await shoot(phone, "phone");
  await untilCapture(page, "complete");
  await press(page, "#open-session");
  // Pictures are loaded when they come near the window.
  await until(page, "the spheres are there", () => {
    document.querySelector("#view-sessions details.fit")?.scrollIntoView();
    return document.querySelector("#view-sessions details.fit .gallery img")?.naturalWidth > 0;
  });
  await page.evaluate(() => window.scrollTo(0, 0));
  await until(page, "the captured lights are there", () => [...document.querySelectorAll("#view-sessions .panel:not(.fit) .gallery img")].every((one) => one.naturalWidth > 0));
  await shoot(page, "after");
} finally {
  await browser.close();
  await desk.stop();
  await place.remove();
}
