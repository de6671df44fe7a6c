// The capture view: the form before a capture, or the one that is running or has ended.

import { by } from "./dom.js";
import { preparePart } from "./prepare.js";
import { runningPart } from "./running.js";
import { capturing } from "./header.js";
import { state, watch } from "./stream.js";

const LEFT = "rig-left-session";

/** Builds the view; the returned function shows and hides it. */
export function startCapture(view) {
  const running = runningPart(() => {
    // The operator is done with this session; a reload must not bring it back.
    sessionStorage.setItem(LEFT, state.capture?.session ?? "");
    show();
  });
  const prepare = preparePart();
  view.append(running.element, prepare.element);
  let shown = false;

  function show() {
    const capture = state.capture;
    const left = capture && !capturing() && sessionStorage.getItem(LEFT) === capture.session;
    const during = capturing() || (capture !== null && !left);
    const [now, before] = during ? [running, prepare] : [prepare, running];
    const focused = before.element.contains(document.activeElement);
    now.element.hidden = false;
    before.element.hidden = true;
    if (focused) by("capture-title").focus({ preventScroll: true });
    running.look(shown && during);
    prepare.look(shown && !during);
  }
  watch(["capture", "job"], show);
  return (on) => {
    shown = on;
    show();
  };
}

