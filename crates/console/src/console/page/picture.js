// A picture that is replaced by newer ones: without a flash, one request at a time, the
// newest alone, and none while nobody looks.

import { askPicture } from "./api.js";
import { h } from "./dom.js";

const GIVE_UP_MS = 10000;
/** Until the first one is there. */
const RETRY_MS = 1000;

/**
 * A picture. `address(n)` is where the n-th is; `interval_ms` the least time between two.
 * `element` shows it; `look(on)` starts and stops; `newer()` says that there is another one.
 */
export function picture(alt, address, interval_ms) {
  const image = h("img", { alt, class: "pixels", draggable: "false" });
  let number = 0;
  let looking = false;
  let wanted = true;
  let request = null;
  let shown = null;
  let timer = null;
  let lastAt = -Infinity;
  let onshown = () => {};

  async function fetchOne() {
    timer = null;
    if (!looking || document.hidden || !wanted || request) return;
    wanted = false;
    lastAt = performance.now();
    request = new AbortController();
    const given = setTimeout(() => request?.abort(), GIVE_UP_MS);
    try {
      number += 1;
      const response = await fetch(address(number), { signal: request.signal, cache: "no-store" });
      if (response.status === 204) setTimeout(again, RETRY_MS);
      else if (response.ok) await replace(await response.blob(), response);
    } catch {
      // The next picture may come; how old this one is stands below it.
    } finally {
      clearTimeout(given);
      request = null;
      schedule();
    }
  }

  async function replace(blob, response) {
    const url = URL.createObjectURL(blob);
    const next = new Image();
    next.src = url;
    try {
      await next.decode();
    } catch {
      URL.revokeObjectURL(url);
      return;
    }
    image.src = url;
    if (shown) URL.revokeObjectURL(shown);
    shown = url;
    image.classList.add("there");
    onshown(Number(response.headers.get("X-Rig-Number")), [next.naturalWidth, next.naturalHeight]);
  }

  function again() {
    wanted = true;
    schedule();
  }

  function schedule() {
    if (!looking || !wanted || timer !== null) return;
    timer = setTimeout(fetchOne, Math.max(0, lastAt + interval_ms - performance.now()));
  }

  document.addEventListener("visibilitychange", again);
  return {
    element: image,
    /** Starts or stops fetching. */
    look(on) {
      if (looking === on) return;
      looking = on;
      if (!on) request?.abort();
      wanted = true;
      schedule();
    },
    /** There is a newer one, or the same with other marks. */
    newer: again,
    /** Nothing to show any more. */
    clear() {
      image.classList.remove("there");
      image.removeAttribute("src");
      if (shown) URL.revokeObjectURL(shown);
      shown = null;
    },
    /** Called with the number and the size of a picture that is shown. */
    set onshown(f) {
      onshown = f;
    },
  };
}

/** One after another, so that other questions have their turn too. */
let turn = Promise.resolve();

/** What is about to scroll into view is loaded. */
const near = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    near.unobserve(target);
    turn = turn.then(() => load(target));
  }
}, { rootMargin: "600px" });

async function load(image) {
  // Its view was left meanwhile.
  if (!image.isConnected) return;
  try {
    const blob = await askPicture(image.dataset.from);
    // Such as of a light that is not merged yet.
    if (!blob) return image.remove();
    const url = URL.createObjectURL(blob);
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    image.src = url;
    image.classList.add("there");
  } catch {
    // STOP gives it up, and so does a console that does not answer.
    setTimeout(() => near.observe(image), RETRY_MS);
  }
}

/**
 * A picture that the console may take seconds to make. Those of a page wait for each other,
 * so that they never hold all the connections that a browser opens: STOP needs one.
 */
export function slowPicture(from, about) {
  const image = h("img", { ...about, "data-from": from });
  near.observe(image);
  return image;
}
