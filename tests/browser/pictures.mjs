// Screenshots of the console for the documents, and its drawings: pictures.mjs FOLDER [drawings]

import { statSync } from "node:fs";
import path from "node:path";
import { LAPTOP, PHONE, openPage, press, startBrowser, startCapture, startConsole, until, untilCapture, workplace } from "./bench.mjs";

const MOST_BYTES = 200e3;
const folder = process.argv[2];
const place = await workplace({ small: false });
const [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);

/** A PNG of a window or an element, checked against the size that the documentation allows. */
async function shoot(shown, name, about = {}) {
  const file = path.join(folder, `${name}.png`);
  await shown.screenshot({ path: file, ...about });
  const { size } = statSync(file);
  if (size > MOST_BYTES) throw new Error(`${file} has ${size} bytes, more than ${MOST_BYTES}`);
  console.log(`${file}: ${size} bytes`);
}

/** Drawings of the page beside each other, each with a title: `[module's function, its argument, title]`. */
async function shootDrawings(page, name, columns, drawings) {
  await page.evaluate(async (columns, drawings) => {
    const all = await import(new URL("drawings.js", document.querySelector("script[src]").src));
    for (const element of document.body.children) element.style.display = "none";
    const sheet = document.body.appendChild(document.createElement("div"));
    sheet.id = "sheet";
    Object.assign(sheet.style, { width: "fit-content", display: "grid", gridTemplateColumns: `repeat(${columns}, 19rem)`, gap: "1rem 2rem", padding: "1rem 1.5rem" });
    for (const [draw, what, title] of drawings) {
      const figure = sheet.appendChild(document.createElement("figure"));
      figure.style.margin = 0;
      const caption = document.createElement("figcaption");
      caption.textContent = title;
      caption.style.fontWeight = "600";
      figure.append(caption, all[draw](what));
    }
  }, columns, drawings);
  const sheet = await page.$("#sheet");
  await shoot(sheet, name);
  await sheet.evaluate((element) => element.remove());
}

/** All drawings. */
async function drawings() {
  const sheets = await openPage(browser, desk.address, "#setup", { width: 1100, height: 900, deviceScaleFactor: 1.5 });
  await shootDrawings(sheets, "bench-cameras", 2, [
    ["benchDrawing", { azimuth_deg: 0, elevation_deg: 90 }, "Camera on the axis"],
    ["benchDrawing", { azimuth_deg: 180, elevation_deg: 36 }, "Camera tilted by 54°"],
  ]);
  await shootDrawings(sheets, "stage-angles", 2, [
    ["drawing", "stage", "The stage's angles"],
    ["drawing", "lamp", "The lamp on its arm"],
  ]);
  await shootDrawings(sheets, "camera-view", 2, [
    ["drawing", "camera", "A frame"],
    ["drawing", "lens", "What of the sample it shows"],
  ]);
  const targets = { sensor: "Sensor, flat field", lamp: "Lamp", white: "White standard", camera: "Lens", focus: "Focus", glare: "Glare", lights: "Lights", pose: "Pose of the sample" };
  await shootDrawings(sheets, "calibration-targets", 3, Object.entries(targets).map(([kind, title]) => ["targetDrawing", kind, title]));
  await sheets.close();
}

/** All screenshots of the console. */
async function screenshots() {
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
  await shoot(page, "console-bench");

  await startCapture(page, { sample: "red-paint", lights: 4, fit: true });
  await until(page, "the second light is captured", () => document.querySelector('.lights tr:nth-child(2)')?.classList.contains("now") && document.querySelector(".picture img.there"));
  await new Promise((resolve) => setTimeout(resolve, 2500));
  await shoot(page, "console-during");
  const phone = await openPage(browser, desk.address, "#capture", { ...PHONE, deviceScaleFactor: 1 });
  await until(phone, "the last frame is shown", () => document.querySelector("#view-capture .picture img.there"));
  await shoot(phone, "console-phone");
  // A tab behind another one draws nothing, and loads no pictures.
  await phone.close();
  await page.bringToFront();
  await untilCapture(page, "complete");
  await press(page, "#open-session");
  // Pictures are loaded when they come near the window.
  await until(page, "the spheres are there", () => {
    document.querySelector("#view-sessions details.fit")?.scrollIntoView();
    return document.querySelector("#view-sessions details.fit .gallery img")?.naturalWidth > 0;
  });
  await page.evaluate(() => window.scrollTo(0, 0));
  await until(page, "the captured lights are there", () => [...document.querySelectorAll("#view-sessions .panel:not(.fit) .gallery img")].every((one) => one.naturalWidth > 0));
  await shoot(page, "console-after", { clip: { x: 0, y: 0, width: LAPTOP.width, height: 860 } });

  // A fit's panel, and the list with a capture that was stopped.
  const { x, y, width } = await page.evaluate(() => {
    document.querySelector("header").style.position = "static";
    const { x, y, width } = document.querySelector("#view-sessions details.fit").getBoundingClientRect();
    return { x, y: y + window.scrollY, width };
  });
  await shoot(page, "console-fit", { clip: { x, y, width, height: 560 } });
  await startCapture(page, { sample: "red-paint-again", lights: 4 });
  await until(page, "its second light is captured", () => document.querySelector(".lights tr:nth-child(2)")?.classList.contains("now"));
  await press(page, "#finish");
  await untilCapture(page, "interrupted");
  await page.evaluate(() => (location.hash = "#sessions"));
  await until(page, "both are listed, with their pictures", () => {
    const pictures = [...document.querySelectorAll("#view-sessions .thumbnail img")];
    return document.querySelectorAll("#view-sessions .thumbnail").length === 2 && pictures.every((one) => one.naturalWidth > 0);
  });
  await shoot(page, "console-sessions", { clip: { x: 0, y: 0, width: LAPTOP.width, height: 400 } });
}

try {
  await drawings();
  if (process.argv[3] !== "drawings") await screenshots();
} finally {
  await browser.close();
  await desk.stop();
  await place.remove();
}
