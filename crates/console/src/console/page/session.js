// One session: verdict, report, pictures, its fits.

import { ask } from "./api.js";
import { facts, h, panel, redraw } from "./dom.js";
import { short, when } from "./format.js";
import { capturing } from "./header.js";
import { capital, complain } from "./notices.js";
import { slowPicture } from "./picture.js";
import { resumeButtons, sessionName } from "./running.js";
import { state } from "./stream.js";
import { badge, done, latest, quality } from "./verdict.js";
import { workPanel } from "./work.js";

/** The address of a file of a session. */
export function fileOf(session, file) {
  return `sessions/${encodeURIComponent(session)}/${file.split("/").map(encodeURIComponent).join("/")}`;
}

/** Pictures with captions. A click opens one in full. */
export function gallery(session, pictures, kind = "") {
  return h(
    "div",
    { class: `gallery ${kind}` },
    pictures.map(({ name, caption }) =>
      h("figure", {}, h("a", { href: fileOf(session, name), target: "_blank", rel: "noopener" }, slowPicture(fileOf(session, name), { alt: caption, class: "pixels" })), h("figcaption", {}, caption)),
    ),
  );
}

/** Warnings of a fit, each with its likely cause. */
export function warningList(warnings) {
  if (!warnings?.length) return h("p", { class: "fine" }, "No warnings.");
  return h("ul", { class: "warnings" }, warnings.map((warning) => h("li", { class: "warn" }, warning.what ?? String(warning), warning.likely_cause ? h("div", { class: "fine" }, `Likely: ${warning.likely_cause}`) : null)));
}

/** The verdict of a session's latest fit, or why it has none. */
export function sessionBadge(session) {
  if (session.error) return h("span", { class: "badge incomplete", title: session.error.error }, "can’t be read");
  if (session.complete) return badge(latest(session));
  if (capturing() && sessionName(state.capture?.session) === session.name) return h("span", { class: "badge none" }, "being captured");
  return h("span", { class: "badge incomplete", title: "The capture is not complete; it can be resumed." }, "interrupted");
}

/** The part of the view; `load(name)` shows a session. */
export function sessionPart() {
  const content = h("div", { class: "stack" });
  const work = workPanel();
  const element = h("div", { class: "stack" }, h("p", {}, h("a", { href: "#sessions" }, "← All sessions")), content, work.element);
  let shown = null;
  async function load(name) {
    if (name !== shown) content.replaceChildren(h("p", { class: "fine" }, "Loading …"));
    shown = name;
    try {
      const session = await ask(`api/sessions/${encodeURIComponent(name)}`);
      if (shown !== name) return;
      redraw(content, session, () => details(session));
      work.show(session);
    } catch (error) {
      content.drawnFrom = null;
      content.replaceChildren(h("p", { class: "error" }, error.message));
      complain(error);
    }
  }
  return { element, load };
}

function details(session) {
  const fit = latest(session);
  const of = session.report_fit ?? null;
  // Another report has another address, so that no older one is shown.
  const report = session.report ? `${fileOf(session.name, "report.html")}?fit=${of ?? ""}` : null;
  const old = report && of !== null && fit && of !== fit.name ? `The report shows fit ${of}; the latest is fit ${fit.name}. A new fit writes the report anew, and so does “rig report” at the terminal.` : null;
  const resumes = resumeButtons("resume-session", () => session.name, () => (location.hash = "#capture"));
  const list = h("dl", { class: "facts across" });
  facts(list, [
    ["Captured", session.began ? when(session.began) : null],
    ["Lights", session.error ? null : done(session)],
    ["Last decision", session.decision ? capital(session.decision) : null],
    ["Bench", session.simulated ? "simulated" : null],
    ["True material", short(session.true_material) ?? null],
    ["Latest fit", quality(fit)],
    ["Folder", session.name],
  ]);
  return [
    h(
      "section",
      { class: "panel" },
      h("h3", { class: "headline" }, short(session.sample) || session.name),
      h("p", { class: "verdict" }, sessionBadge(session), " ", verdictText(session, fit)),
      list,
      session.error ? h("p", { class: "error" }, `${session.error.error}${session.error.hint ? ` – ${session.error.hint}` : ""}`) : null,
      session.warnings?.length ? warningList(session.warnings) : null,
      h(
        "div",
        { class: "row" },
        report ? h("a", { class: "button primary", id: "report", href: report, target: "_blank", rel: "noopener" }, of === null ? "Open the report" : `Open the report of fit ${of}`) : null,
        ...(session.complete || session.error ? [] : resumes),
      ),
      old ? h("p", { class: "warn" }, old) : null,
      report ? reportFrame(report) : null,
    ),
    ...(session.validation ? [validationPanel(session.name, session.validation)] : []),
    ...(session.pictures?.length ? [panel("Pictures", {}, gallery(session.name, session.pictures))] : []),
    ...[...(session.fits ?? [])].reverse().map((one, i) => fitPanel(session.name, one, i === 0)),
  ];
}

function verdictText(session, fit) {
  if (session.error) return "";
  if (!session.complete) return `The capture is not complete: ${done(session)} are captured. Resume it to measure the others.`;
  return fit?.verdict_text ? `${fit.verdict_text}.` : "This session has not been fitted.";
}

/** Errors and pictures of images that a fit had not seen. */
function validationPanel(session, validation) {
  if (validation.error) return panel("Predicted, unseen images", {}, h("p", { class: "error" }, validation.error.error));
  const [first, ...others] = validation.headings;
  const head = h("tr", {}, h("th", { scope: "col" }, first), others.map((name) => h("th", { scope: "col", class: "n" }, name)));
  const rows = validation.rows.map(([light, ...cells]) => h("tr", {}, h("th", { scope: "row" }, light), cells.map((cell) => h("td", { class: "n" }, cell))));
  const table = h("table", { class: "errors" }, h("caption", { class: "unseen" }, "Relative errors of the predictions by light"), h("thead", {}, head), h("tbody", {}, rows));
  return panel(
    "Predicted, unseen images",
    { id: "validation" },
    h("p", { class: "fine" }, `Validation ${validation.name}: ${validation.about}`),
    h("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Table of errors" }, table),
    gallery(session, validation.pictures, "figures"),
  );
}

/** The report in a frame that runs no scripts, loaded when it is opened. */
function reportFrame(address) {
  const box = h("details", {}, h("summary", {}, "Show the report here"));
  box.addEventListener("toggle", () => {
    if (box.open && box.children.length === 1) box.append(h("iframe", { src: address, sandbox: "", title: "Report", class: "report" }));
  });
  return box;
}

function fitPanel(session, fit, first) {
  const settings = h("dl", { class: "facts" });
  facts(settings, Object.entries(fit.settings ?? {}));
  return h(
    "details",
    { class: "panel fit", open: first },
    h("summary", {}, h("h3", {}, `Fit ${fit.name}`), " ", badge(fit), " ", h("span", { class: "fine" }, quality(fit))),
    fit.error ? h("p", { class: "error" }, fit.error.error) : warningList(fit.warnings),
    fit.remarks?.length ? h("ul", { class: "warnings" }, fit.remarks.map((remark) => h("li", { class: "fine" }, remark))) : null,
    fit.pictures?.length ? gallery(session, fit.pictures) : null,
    h("details", {}, h("summary", {}, "Settings"), settings),
  );
}
