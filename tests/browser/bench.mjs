// A small simulated bench, the console on it, and a browser before it.

import { execFile, spawn } from "node:child_process";
import { cp, mkdtemp, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";
import puppeteer from "puppeteer-core";

const ROOT = fileURLToPath(new URL("../../", import.meta.url));
const RIG = path.resolve(ROOT, process.env.RIG ?? "target/release/rig");
const CHROMIUM = process.env.CHROMIUM ?? "/usr/bin/chromium";
/** A fit takes a quarter of a minute of a whole core, which other tests may leave little of. */
const PATIENCE_MS = 600000;

const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** Sizes of windows. */
export const LAPTOP = { width: 1280, height: 800 };
export const PHONE = { width: 390, height: 844, isMobile: true, hasTouch: true };

/**
 * A folder with a rig file of the simulated bench, whose truth is rendered quickly.
 * `timing`: "instant", or "realistic" for tests that act in mid-capture; `small`: 64 × 64 pixels, few paths.
 */
export async function workplace({ timing = "realistic", small = true } = {}) {
  const folder = await mkdtemp(path.join(tmpdir(), "rig-console-"));
  const text = await readFile(path.join(ROOT, "rig-configs/simulated.toml"), "utf8");
  // A laboratory that states all it can.
  const stated = text.replace(/\n\[lab\][^]*?\n# ---/, (lab) => lab.replace(/\n# (\w+ = )/g, "\n$1"));
  const changes = {
    timing: `"${timing}"`,
    // Simulated devices share a busy machine with the tests.
    reply_timeout_s: "20.0",
    connect_timeout_s: "20.0",
    frame_timeout_s: "20.0",
    ...(small ? { samples_per_pixel: "2", max_reflections: "2", resolution_px: "[64, 64]", extent_mm: "[22.0, 22.0]", point_spread_px: "0.0" } : {}),
  };
  const lines = stated.split("\n").map((line) => {
    const [key] = line.split(" = ");
    return key in changes ? `${key} = ${changes[key]}` : line;
  });
  await writeFile(path.join(folder, "rig.toml"), lines.join("\n"));
  if (small) {
    for (const kind of ["sensor", "flat", "scale"]) {
      await cp(path.join(ROOT, "tests/support/small_bench/calibration", kind), path.join(folder, "calibration/simulated", kind), { recursive: true });
    }
  }
  return { folder, remove: () => rm(folder, { recursive: true, force: true }) };
}

/** Runs the program to its end. */
export async function rig(folder, ...words) {
  const environment = { ...process.env };
  delete environment.RIG_CONFIG;
  return promisify(execFile)(RIG, words, { cwd: folder, env: environment, maxBuffer: 1 << 26 });
}

/** Starts the console in this folder; `address` is what it prints. */
export async function startConsole(folder, ...words) {
  const child = spawn(RIG, ["console", "--rig", "rig.toml", ...words], { cwd: folder, stdio: ["ignore", "pipe", "pipe"] });
  let log = "";
  child.stderr.on("data", (data) => (log += data));
  const ended = new Promise((resolve) => child.once("exit", resolve));
  const address = await new Promise((resolve, reject) => {
    let out = "";
    child.stdout.on("data", (data) => {
      out += data;
      const found = out.match(/http:\/\/\S+/);
      if (found) resolve(found[0]);
    });
    ended.then((code) => reject(new Error(`rig console ended with ${code}: ${log}`)));
  });
  return {
    address,
    pid: child.pid,
    log: () => log,
    async stop() {
      if (child.exitCode === null && child.signalCode === null) child.kill("SIGTERM");
      await ended;
    },
  };
}

/** A browser; it ends with the tests. */
export function startBrowser() {
  return puppeteer.launch({ executablePath: CHROMIUM, args: ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"] });
}

/**
 * Opens a view in a tab of its own, with its own identity. What the browser complains of
 * (errors of scripts, refused by the content security policy) is in `complaints`.
 */
export async function openPage(browser, address, view = "", size = LAPTOP) {
  const page = await browser.newPage();
  page.complaints = [];
  page.on("pageerror", (error) => page.complaints.push(error.message));
  page.on("console", (message) => {
    // Answers with a status above 400 are what some tests provoke.
    if (message.type() === "error" && !message.text().includes("status of 4")) page.complaints.push(message.text());
  });
  if (process.env.PAGE_FROM_SOURCE) await serveFromSource(page, address);
  await page.setViewport(size);
  await page.goto(address + view, { waitUntil: "load" });
  await until(page, "the page is live", () => document.querySelector("#link").dataset.kind === "live" && document.title !== "rig console");
  return page;
}

/** Answers requests for the page's own files from the source tree, so that work on them needs no build. */
async function serveFromSource(page, address) {
  const kinds = { ".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml" };
  await page.setRequestInterception(true);
  page.on("request", async (request) => {
    const name = request.url().startsWith(address) ? request.url().slice(address.length).split(/[?#]/)[0] || "index.html" : "";
    const kind = name.includes("/") ? undefined : kinds[path.extname(name)];
    if (!kind) return request.continue();
    const body = await readFile(path.join(ROOT, "crates/console/src/console/page", name));
    request.respond({ contentType: kind, body });
  });
}

/** Waits until this is true in the page. Puppeteer's own function needs `eval`, which the page forbids. */
export async function until(page, what, condition, ...given) {
  const end = Date.now() + PATIENCE_MS;
  for (;;) {
    const value = await page.evaluate(condition, ...given).catch((error) => {
      // The page is loaded anew, as it is for another bench, and does not show all yet.
      if (!/context was destroyed|Cannot find context|properties of null/.test(error.message)) throw error;
      return false;
    });
    if (value) return value;
    if (Date.now() > end) throw new Error(`waited for: ${what}; the page shows: ${await page.evaluate(() => document.querySelector("main").innerText.slice(0, 1500))}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

/** The text of an element, "" if it is hidden. */
export function textOf(page, selector) {
  return page.$eval(selector, (element) => element.innerText.trim());
}

/** Waits until a control can be pressed, and presses it. */
export async function press(page, selector) {
  await until(page, `${selector} can be pressed`, (wanted) => {
    const element = document.querySelector(wanted);
    return element && element.checkVisibility() && !element.disabled;
  }, selector);
  await page.$eval(selector, (element) => element.click());
}

/** What the capture view says that the capture does. */
export function untilCapture(page, ...states) {
  return until(page, `the capture is ${states.join(" or ")}`, (wanted) => wanted.includes(document.querySelector(".doing")?.dataset.state), states);
}

/** Closes the pages of a test, so that none holds control in the next one. */
export async function closePages(browser) {
  await Promise.all((await browser.pages()).slice(1).map((page) => page.close()));
}

/** Fills the form and starts a capture; the page takes control and leaves the capture before. */
export async function startCapture(page, { sample, lights = 1, fit = false }) {
  await page.evaluate(() => (location.hash = "#capture"));
  if ((await page.$eval("#control", (control) => control.dataset.mine)) === "no") await press(page, "#take");
  await until(page, "this page controls", () => document.querySelector("#control").dataset.mine === "yes");
  await until(page, "the form is there", () => {
    const next = document.querySelector("#next");
    if (next.checkVisibility()) next.click();
    return document.querySelector("#sample").checkVisibility();
  });
  await page.$eval("#sample", (input) => (input.value = ""));
  await page.type("#sample", sample);
  await page.$eval("#lights", (input, value) => (input.value = value), String(lights));
  await page.$eval("#fit", (input, value) => (input.checked = value), fit);
  await page.$eval("#lights", (input) => input.dispatchEvent(new Event("input", { bubbles: true })));
  await press(page, "#start");
}

/** The session's folder whose sample has this name. */
export async function sessionOf(folder, sample) {
  const names = await readdir(path.join(folder, "sessions"));
  const found = names.filter((name) => name.includes(`_${sample}_`));
  if (found.length !== 1) throw new Error(`${found.length} sessions of ${sample} among ${names.join(", ")}`);
  return path.join(folder, "sessions", found[0]);
}

/** What axe finds inaccessible on the page as it is. */
export async function violations(page) {
  await page.evaluate(axe);
  return page.evaluate(async () => (await globalThis.axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`));
}
