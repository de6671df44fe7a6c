// Whether the devices of the bench in use answer: a frame, the stage's reference, a lit lamp.

import { act } from "./api.js";
import { gate, h, panel, say } from "./dom.js";
import { exposure } from "./format.js";
import { blocked, working } from "./header.js";
import { capital } from "./notices.js";
import { state, watch } from "./stream.js";

const WAIT_MS = 60000;
const LAMP_MS = 2000;
const after = (ms) => new Promise((then) => setTimeout(then, ms));

/** Three buttons, and what came of the one that was pressed last. */
export function tryPanel() {
  const said = h("p", { role: "status", id: "tried" });
  const frame = h("img", { class: "pixels tried", alt: "The frame that was taken", hidden: true });
  let doing = false;
  let since = null;
  const test = (label, id, run) => h("button", { type: "button", id, onclick: () => carryOut(label, run) }, label);
  const take = test("Take a frame", "try-frame", async () => {
    const before = state.bench.view?.number;
    await reached(() => state.bench.view && state.bench.view.number !== before);
    const { number, width, height, exposure_s } = state.bench.view;
    frame.src = `api/live.jpg?n=${number}`;
    frame.hidden = false;
    return `A frame of ${width} × ${height} pixels, exposed for ${exposure(exposure_s)}.`;
  });
  const home = test("Home", "try-home", async () => {
    await act("api/bench/home");
    await reached(() => !state.bench.busy && state.bench.stage?.position);
    return "The stage has found its reference.";
  });
  const lamp = test("Lamp on for 2 s", "try-lamp", async () => {
    try {
      await act("api/bench/lamp", { channel: 0 });
      await reached(() => state.bench.stage?.lamp === 0);
      await after(LAMP_MS);
    } finally {
      await act("api/bench/lamp", { channel: null });
    }
    await reached(() => state.bench.stage?.lamp === null);
    return `The lamp was on (${state.console?.rig?.channels?.[0] ?? "its first channel"}) and is off.${state.bench.stage?.lamp_word === "reported" ? "" : " This stage does not report its lamp: did you see it?"}`;
  });
  const element = panel("Try the bench in use", {}, h("p", {}, "Keep the emergency stop at hand before the stage moves for the first time."), h("div", { class: "row" }, take, home, lamp), said, frame);

  async function carryOut(label, run) {
    doing = true;
    show();
    said.className = "";
    say(said, `${label} …`);
    try {
      if (!state.bench?.connected) {
        await act("api/bench/connect");
        await reached(() => state.bench?.connected && !state.bench.busy);
      }
      say(said, await run());
    } catch (failure) {
      said.className = "error";
      say(said, `${capital(failure.message)}${failure.hint ? ` – ${failure.hint}` : ""}`);
    }
    doing = false;
    show();
  }
  function show() {
    // What was tried was another bench.
    if (since !== (since = state.console?.since ?? null) && !doing) {
      say(said, "");
      frame.hidden = true;
    }
    const hasStage = state.console?.mode !== "camera" && state.console?.rig?.has_stage !== false;
    home.hidden = lamp.hidden = !hasStage;
    const reason = blocked() ?? (doing ? "A test is under way." : working() ? "A job is running." : (state.bench?.busy ?? null));
    for (const button of [take, home, lamp]) gate(button, reason);
  }
  watch(["bench", "console", "control", "job", "link"], show);
  return element;
}

/** Waits until the bench is so; its error ends the waiting. */
async function reached(is) {
  const end = performance.now() + WAIT_MS;
  // What the bench last heard of may be older than the command.
  await after(300);
  while (!is()) {
    const { error, hint } = state.bench?.error ?? {};
    if (error) throw Object.assign(new Error(error), { hint });
    if (performance.now() > end) throw new Error("the bench did not come to it within a minute");
    await after(100);
  }
}
