// The console does no harm: a session captured under it, with pages that look and one that
// has stalled, is the one that is captured without it.

import assert from "node:assert/strict";
import { readFile, readdir } from "node:fs/promises";
import net from "node:net";
import path from "node:path";
import { after, before, test } from "node:test";
import { openPage, rig, sessionOf, startBrowser, startCapture, startConsole, until, untilCapture, workplace } from "./bench.mjs";

let place, desk, browser;
before(async () => {
  place = await workplace({ timing: "instant" });
  [desk, browser] = await Promise.all([startConsole(place.folder), startBrowser()]);
});
after(async () => {
  await browser?.close();
  await desk?.stop();
  await place?.remove();
});

/** A client that asks for the events, and for pictures, and never reads an answer. */
function stalled(address, query) {
  const url = new URL(address);
  return new Promise((resolve, reject) => {
    const socket = net.connect({ host: url.hostname, port: url.port }, () => {
      socket.pause();
      socket.write(`GET ${url.pathname}${query} HTTP/1.1\r\nHost: ${url.host}\r\n\r\n`, () => resolve(socket));
    });
    socket.on("error", reject);
  });
}

/** Every file of a session by name, without what differs between any two captures: times, and what is derived from them. */
async function content(session) {
  const files = new Map();
  for (const entry of await readdir(session, { recursive: true, withFileTypes: true })) {
    if (!entry.isFile()) continue;
    const file = path.join(entry.parentPath ?? entry.path, entry.name);
    const name = path.relative(session, file);
    const bytes = await readFile(file);
    if (name === "manifest-sha256.txt") continue; // sums of the files below
    if (name === "journal.jsonl") files.set(name, journal(bytes.toString()));
    else if (name.endsWith(".toml")) files.set(name, withoutTimes(bytes.toString()));
    else files.set(name, bytes.toString("base64"));
  }
  return files;
}

/** Without times, what runs with time (the count of frames, the temperatures), and the number of the pseudo-terminal behind which the simulated stage is. */
function withoutTimes(text) {
  return text.split("\n").filter((line) => !/^(created_utc|utc|monotonic_s|device_s|device_sequence|sensor_c|lamp_c|port) = /.test(line)).join("\n");
}

/**
 * The events without their times and numbers, and without the sums of files that hold times.
 * Images are merged next to the capture, so their lines may come sooner or later: they stand last.
 */
function journal(text) {
  const timed = ["number", "utc", "sha256", "bytes", "monotonic_s", "elapsed_s"];
  const lines = text.trim().split("\n").map((line) => JSON.stringify(JSON.parse(line).record, (key, value) => (timed.includes(key) ? undefined : value)));
  const merged = (line) => line.includes('"derived/');
  return [...lines.filter((line) => !merged(line)), ...lines.filter(merged).sort()].join("\n");
}

test("a session is the same byte for byte but for times, stalled clients or none", async () => {
  const page = await openPage(browser, desk.address, "#capture");
  const stuck = await Promise.all([...Array(6).keys()].map((i) => stalled(desk.address, `api/events?viewer=stalled-${i}`)));
  await startCapture(page, { sample: "same", lights: 2 });
  await untilCapture(page, "complete");
  await until(page, "the last frame is shown", () => document.querySelector(".picture img.there")?.checkVisibility());
  const watched = await content(await sessionOf(place.folder, "same"));
  for (const socket of stuck) socket.destroy();

  const alone = await workplace({ timing: "instant" });
  await rig(alone.folder, "capture", "--rig", "rig.toml", "--sample", "same", "--lights", "2", "--no-fit", "--quiet");
  const plain = await content(await sessionOf(alone.folder, "same"));
  await alone.remove();

  assert.deepEqual([...watched.keys()].sort(), [...plain.keys()].sort());
  assert.ok([...plain.keys()].some((name) => name.startsWith("raw/") && name.endsWith(".png")), "no frames");
  for (const [name, text] of plain) {
    const [lines, others] = [text, watched.get(name)].map((whole) => whole.split("\n"));
    const first = lines.findIndex((line, i) => line !== others[i]);
    assert.ok(text === watched.get(name), `${name} differs: ${lines[first]?.slice(0, 300)} without, ${others[first]?.slice(0, 300)} with the console`);
  }
  assert.deepEqual(page.complaints, []);
});
