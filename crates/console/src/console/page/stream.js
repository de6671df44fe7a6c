// The console's event stream: the newest state of each topic, and how old it is.

import { viewer } from "./api.js";

const TOPICS = ["console", "control", "bench", "job", "capture", "sessions"];
/** The server sends something every 5 s. */
const STALE_AFTER_S = 12;
const REOPEN_AFTER_S = 20;
/** A browser opens six connections to one address; a tab that nobody sees gives its one back. */
const HIDDEN_FOR_S = 60;

/** Newest state by topic; null before the first one. */
export const state = Object.fromEntries(TOPICS.map((topic) => [topic, null]));

const watchers = new Map();
let source = null;
let heardAt = performance.now();
let clockOffset_ms = 0;
let hiddenSince = null;
let reopening = null;

/** Calls `f` whenever one of these topics changes; "link" for the connection itself. */
export function watch(topics, f) {
  for (const topic of topics) watchers.set(topic, [...(watchers.get(topic) ?? []), f]);
}

function tell(topic) {
  for (const f of watchers.get(topic) ?? []) f();
}

/** The server's clock. */
export function now() {
  return Date.now() + clockOffset_ms;
}

/** Seconds since this UTC time of the server. */
export function secondsSince(utc) {
  return (now() - Date.parse(utc)) / 1000;
}

/** "live", "connecting", "stale" or "paused", and the seconds since something was heard. */
export function link() {
  const silent_s = (performance.now() - heardAt) / 1000;
  if (source === null && hiddenSince !== null) return { kind: "paused", silent_s };
  if (source === null || source.readyState !== EventSource.OPEN) return { kind: "connecting", silent_s };
  return { kind: silent_s > STALE_AFTER_S ? "stale" : "live", silent_s };
}

/** Opens the stream and keeps it open. */
export function open() {
  close();
  const opened = new EventSource(`api/events?viewer=${encodeURIComponent(viewer())}`);
  source = opened;
  opened.addEventListener("open", heard);
  opened.addEventListener("alive", (event) => {
    const at = Date.parse(JSON.parse(event.data).at);
    if (Number.isFinite(at)) clockOffset_ms = at - Date.now();
    heard();
  });
  for (const topic of TOPICS) {
    opened.addEventListener(topic, (event) => {
      state[topic] = JSON.parse(event.data);
      heard();
      tell(topic);
    });
  }
  // A refused connection is retried by the browser, an answer that is no stream is not.
  opened.addEventListener("error", () => {
    tell("link");
    if (opened.readyState === EventSource.CLOSED && source === opened) {
      close();
      reopening ??= setTimeout(() => {
        reopening = null;
        open();
      }, 2000);
    }
  });
}

function close() {
  source?.close();
  source = null;
}

function heard() {
  heardAt = performance.now();
  tell("link");
}

setInterval(() => {
  const { kind, silent_s } = link();
  if (kind === "stale" && silent_s > REOPEN_AFTER_S) {
    heardAt = performance.now() - STALE_AFTER_S * 1000;
    open();
  }
  const controls = state.control?.viewer === viewer();
  if (hiddenSince !== null && !controls && performance.now() - hiddenSince > HIDDEN_FOR_S * 1000) close();
  tell("link");
}, 1000);

document.addEventListener("visibilitychange", () => {
  hiddenSince = document.hidden ? performance.now() : null;
  if (!document.hidden && source === null) open();
});
