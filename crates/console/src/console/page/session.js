// One session: verdict, report, pictures, its fits, fit again, export.

import { ask } from "./api.js";
import { facts, field, gate, h, panel, redraw, say } from "./dom.js";
import { short, when } from "./format.js";
import { attempt, blocked, capturing } from "./header.js";
import { announce, complain } from "./notices.js";
import { resumeButtons } from "./running.js";
import { state, watch } from "./stream.js";
import { badge, latest, quality } from "./verdict.js";

/** The address of a file of a session. */
export function fileOf(session, file) {
  return `sessions/${encodeURIComponent(session)}/${file.split("/").map(encodeURIComponent).join("/")}`;
}

/** The name of the file at an address. */
function nameOf(address) {
  return decodeURIComponent(address.split("/").pop());
}

/** Pictures with captions. A click opens one in full. */
export function gallery(session, pictures, kind = "") {
  return h(
    "div",
    { class: `gallery ${kind}` },
    pictures.map(({ name, caption }) =>
      h("figure", {}, h("a", { href: fileOf(session, name), target: "_blank", rel: "noopener" }, h("img", { src: fileOf(session, name), alt: caption, loading: "lazy", class: "pixels there" })), h("figcaption", {}, caption)),
    ),
  );
}

/** Warnings of a fit, each with its likely cause. */
export function warningList(warnings) {
  if (!warnings?.length) return h("p", { class: "fine" }, "No warnings.");
  return h("ul", { class: "warnings" }, warnings.map((warning) => h("li", { class: "warn" }, warning.what ?? String(warning), warning.likely_cause ? h("div", { class: "fine" }, `Likely: ${warning.likely_cause}`) : null)));
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
  const report = session.report ? fileOf(session.name, "report.html") : null;
  const resumes = resumeButtons("resume-session", () => session.name, () => (location.hash = "#capture"));
  const list = h("dl", { class: "facts across" });
  facts(list, [
    ["Captured", session.began ? when(session.began) : null],
    ["Lights", session.error ? null : String(session.lights)],
    ["Bench", session.simulated ? "simulated" : null],
    ["True material", short(session.material) ?? null],
    ["Latest fit", quality(fit)],
    ["Folder", session.name],
  ]);
  return [
    h(
      "section",
      { class: "panel" },
      h("h3", { class: "headline" }, short(session.sample) || session.name),
      h("p", { class: "verdict" }, badge(fit), " ", fit?.verdict_text ? `${fit.verdict_text}.` : "This session has not been fitted."),
      list,
      session.error ? h("p", { class: "error" }, `${session.error.error}${session.error.hint ? ` – ${session.error.hint}` : ""}`) : null,
      session.warnings?.length ? warningList(session.warnings) : null,
      h(
        "div",
        { class: "row" },
        report ? h("a", { class: "button primary", id: "report", href: report, target: "_blank", rel: "noopener" }, "Open the report") : null,
        ...(session.complete || session.error ? [] : resumes),
      ),
      report ? reportFrame(report) : null,
    ),
    ...(session.validation ? [validationPanel(session.name, session.validation)] : []),
    ...(session.pictures?.length ? [panel("Pictures", {}, gallery(session.name, session.pictures))] : []),
    ...[...(session.fits ?? [])].reverse().map((one, i) => fitPanel(session.name, one, i === 0)),
  ];
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
  facts(settings, [["Dictionary", fit.dictionary ?? null], ...Object.entries(fit.settings ?? {}).map(([key, value]) => [key.replaceAll("_", " "), String(value)])]);
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

/** Fit again and export, with progress. */
function workPanel() {
  let session = null;
  // Fit again.
  const dictionary = h("select", { id: "dictionary" }, [["", "rig65 (the default)"], ["rig26", "rig26, three times as fast"], ["paper42", "paper42, the paper's"]].map(([value, label]) => h("option", { value }, label)));
  const error = h("input", { type: "number", id: "model-error", min: "0", max: "1", step: "any", placeholder: "0.02", inputmode: "decimal" });
  const refine = h("input", { type: "checkbox" });
  const shared = h("input", { type: "checkbox" });
  const fit = h("button", { type: "submit", id: "fit-again" }, "Fit again");
  const fitForm = h(
    "form",
    { class: "stack-form" },
    field("Dictionary", dictionary),
    field("Relative error of the model", error),
    h("label", { class: "choice" }, refine, h("span", {}, "refine light directions, intensities and pose")),
    h("label", { class: "choice" }, shared, h("span", {}, "the same weights for all channels")),
    fit,
  );
  fitForm.addEventListener("submit", async (event) => {
    event.preventDefault();
    const body = {};
    if (dictionary.value) body.dictionary = dictionary.value;
    if (error.value !== "") body.model_error = error.valueAsNumber;
    if (refine.checked) body.refine_bench = true;
    if (shared.checked) body.shared_weights = true;
    if (await attempt(`api/sessions/${encodeURIComponent(session.name)}/fit`, body)) announce("The fit has started");
  });
  // Export.
  const which = h("select", { id: "export-fit" });
  const format = h("select", { id: "export-format" });
  const write = h("button", { type: "submit", id: "export" }, "Export");
  const exportForm = h("form", { class: "stack-form" }, field("Fit", which), field("Format", format), write);
  exportForm.addEventListener("submit", async (event) => {
    event.preventDefault();
    await attempt(`api/sessions/${encodeURIComponent(session.name)}/export`, { fit: which.value, format: format.value });
  });
  // Progress of either.
  const status = h("p", { role: "status" });
  const bar = h("progress", { max: "1", "aria-label": "Progress" });
  const download = h("a", { class: "button primary", id: "download", download: true }, "Download");
  const log = h("pre", { class: "log", tabindex: "0", "aria-label": "Log" });
  const logBox = h("details", {}, h("summary", {}, "What the program says"), log);
  const halt = h("button", { type: "button", id: "stop-job", onclick: () => attempt("api/jobs/stop") }, "Stop this job");
  const more = h("div", { class: "row" });
  const progress = h("div", { class: "panel work" }, status, bar, halt, download, more, logBox);
  const why = h("p", { class: "why" });
  const element = h("div", { class: "stack" }, progress, why, h("div", { class: "two" }, panel("Fit again", {}, fitForm), panel("Export", {}, exportForm)));

  function show(shown) {
    if (shown) session = shown;
    element.hidden = session === null;
    if (session === null) return;
    const fits = [...(session.fits ?? [])].reverse();
    redraw(which, fits.map((one) => one.name), () => fits.map((one) => h("option", { value: one.name }, `fit ${one.name}, ${one.dictionary ?? ""}`)));
    const formats = state.console?.formats ?? [];
    redraw(format, formats.map(([name]) => name), () => formats.map(([value, about]) => h("option", { value }, `${value}: ${about}`)));
    const job = state.job;
    for (const resume of document.querySelectorAll("[id^=resume-session]")) gate(resume, blocked() ?? (capturing() ? "A capture is running." : null));
    const busy = job && ["running", "paused", "ending"].includes(job.state) ? `A ${job.kind} is running.` : null;
    const reason = blocked() ?? busy;
    gate(fit, reason ?? (session.complete ? null : "The session is not complete."));
    gate(write, reason ?? (fits.length ? null : "There is no fit to export."));
    say(why, reason ?? "");
    showJob(job);
  }

  function showJob(job) {
    const mine = job && ["fit", "export"].includes(job.kind) && job.session === session.name;
    progress.hidden = !mine;
    if (!mine) return;
    const running = job.state === "running";
    const stage = job.progress?.stage ? `: ${job.progress.stage}` : "";
    const name = job.kind === "fit" ? "Fit" : "Export";
    say(status, running ? `${name}${stage} …` : job.state === "done" ? `${name} done.` : `${name} ${job.state}.`);
    bar.hidden = !running;
    halt.hidden = !running;
    if (Number.isFinite(job.progress?.done)) bar.value = job.progress.done;
    else bar.removeAttribute("value");
    download.hidden = !(job.kind === "export" && job.state === "done" && job.download);
    if (!download.hidden) {
      download.setAttribute("href", job.download);
      say(download, `Download ${nameOf(job.download)}`);
    }
    const others = download.hidden ? [] : (job.downloads ?? []).slice(1);
    redraw(more, others, () => others.map((address) => h("a", { class: "button", href: address, download: true }, `Download ${nameOf(address)}`)));
    say(log, (job.log ?? []).join("\n"));
    logBox.open ||= job.state === "failed";
  }
  watch(["job", "control", "link"], () => show(null));
  show(null);
  return { element, show };
}
