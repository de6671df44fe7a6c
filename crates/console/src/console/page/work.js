// What is made of a session: another fit, exports, a certificate, with progress.

import { field, gate, h, panel, redraw, say } from "./dom.js";
import { attempt, blocked, capturing } from "./header.js";
import { announce } from "./notices.js";
import { state, watch } from "./stream.js";

const DICTIONARIES = [["", "rig65 (the default)"], ["rig26", "rig26, three times as fast"], ["paper42", "paper42, the paper's"]];
const CERTIFICATE = "certificate";

/** The name of the file at an address. */
function nameOf(address) {
  return decodeURIComponent(address.split("/").pop());
}

/** The panels; `show(session)` sets whose they are. */
export function workPanel() {
  let session = null;
  const address = (what) => `api/sessions/${encodeURIComponent(session.name)}/${what}`;
  const fit = fitForm(async (body) => {
    if (await attempt(address("fit"), body)) announce("The fit has started");
  });
  const exports = exportForm((body) => attempt(address("export"), body));
  const progress = progressPanel();
  const why = h("p", { class: "why" });
  const element = h("div", { class: "stack" }, progress.element, why, h("div", { class: "two" }, fit.element, exports.element));

  function show(shown) {
    if (shown) session = shown;
    const job = state.job;
    for (const resume of document.querySelectorAll("[id^=resume-session]")) gate(resume, blocked() ?? (capturing() ? "A capture is running." : null));
    element.hidden = session === null;
    if (session === null) return;
    const busy = job && ["running", "paused", "ending"].includes(job.state) ? `A ${job.kind} is running.` : null;
    const reason = blocked() ?? busy;
    fit.show(session, reason);
    exports.show(session, reason);
    say(why, fit.element.hidden && exports.element.hidden ? "" : (reason ?? ""));
    progress.show(job?.session === session.name ? job : null);
  }
  watch(["job", "control", "link"], () => show(null));
  show(null);
  return { element, show };
}

/** The form of another fit; a session that can't be fitted has none. */
function fitForm(start) {
  const dictionary = h("select", { id: "dictionary" }, DICTIONARIES.map(([value, label]) => h("option", { value }, label)));
  const error = h("input", { type: "number", id: "model-error", min: "0", max: "1", step: "any", placeholder: "0.02", inputmode: "decimal" });
  const refine = h("input", { type: "checkbox" });
  const shared = h("input", { type: "checkbox" });
  const fit = h("button", { type: "submit", id: "fit-again" }, "Fit again");
  const form = h(
    "form",
    { class: "stack-form" },
    field("Dictionary", dictionary),
    field("Relative error of the model", error),
    h("label", { class: "choice" }, refine, h("span", {}, "refine light directions, intensities and pose")),
    h("label", { class: "choice" }, shared, h("span", {}, "the same weights for all channels")),
    fit,
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const body = {};
    if (dictionary.value) body.dictionary = dictionary.value;
    if (error.value !== "") body.model_error = error.valueAsNumber;
    if (refine.checked) body.refine_bench = true;
    if (shared.checked) body.shared_weights = true;
    start(body);
  });
  const element = panel("Fit", {}, form);
  function show(session, reason) {
    element.hidden = !session.complete;
    say(fit, session.fits?.length ? "Fit again" : "Fit");
    gate(fit, reason);
  }
  return { element, show };
}

/** Files for other programs, and the certificate; a session without a fit has neither. */
function exportForm(start) {
  const which = h("select", { id: "export-fit" });
  const format = h("select", { id: "export-format" });
  const write = h("button", { type: "submit", id: "export" }, "Export");
  const certificate = h("button", { type: "button", id: "certificate" }, "Certificate");
  const form = h("form", { class: "stack-form" }, field("Fit", which), field("Format", format), h("div", { class: "row" }, write, certificate), h("p", { class: "fine" }, "A certificate states the result with its uncertainty on two pages."));
  const fits = () => [...(shown?.fits ?? [])].reverse();
  let shown = null;
  let reason = null;
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    start({ fit: which.value, format: format.value });
  });
  certificate.addEventListener("click", () => start({ fit: which.value, format: CERTIFICATE }));
  which.addEventListener("change", gates);
  const element = panel("Export", {}, form);
  function gates() {
    gate(write, reason);
    const chosen = fits().find((one) => one.name === which.value);
    const refused = !shown.complete ? "The session is not complete." : chosen?.verdict === "not-to-be-trusted" ? "A certificate is made of a fit that is to be trusted." : null;
    gate(certificate, reason ?? refused);
  }
  function show(session, because) {
    shown = session;
    reason = because;
    element.hidden = !fits().length;
    redraw(which, fits().map((one) => one.name), () => fits().map((one) => h("option", { value: one.name }, `fit ${one.name}, ${one.dictionary ?? ""}`)));
    const formats = state.console?.formats ?? [];
    redraw(format, formats.map(([name]) => name), () => formats.map(([value, about]) => h("option", { value }, `${value}: ${about}`)));
    gates();
  }
  return { element, show };
}

/** Progress and results of a fit or an export. */
function progressPanel() {
  const status = h("p", { role: "status" });
  const bar = h("progress", { max: "1", "aria-label": "Progress" });
  const download = h("a", { class: "button primary", id: "download", download: true }, "Download");
  const said = h("ul", { class: "warnings", id: "said" });
  const log = h("pre", { class: "log", tabindex: "0", "aria-label": "Log" });
  const logBox = h("details", {}, h("summary", {}, "What the program says"), log);
  const halt = h("button", { type: "button", id: "stop-job", onclick: () => attempt("api/jobs/stop") }, "Stop this job");
  const more = h("div", { class: "row" });
  const seen = h("div", { class: "gallery figures" });
  const element = h("div", { class: "panel work" }, status, bar, halt, said, download, more, seen, logBox);

  function show(job) {
    const mine = job && ["fit", "export"].includes(job.kind);
    element.hidden = !mine;
    if (!mine) return;
    const running = job.state === "running";
    const stage = job.progress?.stage ? `: ${job.progress.stage}` : "";
    const name = job.kind === "fit" ? "Fit" : (job.command ?? "").includes("--certificate") ? "Certificate" : "Export";
    say(status, running ? `${name}${stage} …` : job.state === "done" ? `${name} done.` : `${name} ${job.state}.`);
    bar.hidden = !running;
    halt.hidden = !running;
    if (Number.isFinite(job.progress?.done)) bar.value = job.progress.done;
    else bar.removeAttribute("value");
    const files = job.kind === "export" && job.state === "done" ? (job.downloads ?? []) : [];
    download.hidden = files.length === 0;
    if (!download.hidden) {
      download.setAttribute("href", files[0]);
      say(download, `Download ${nameOf(files[0])}`);
    }
    redraw(more, files.slice(1), () => files.slice(1).map((file) => h("a", { class: "button", href: file, download: true }, `Download ${nameOf(file)}`)));
    // A file of this name may have been replaced by this job.
    const pictures = files.filter((file) => file.endsWith(".png"));
    redraw(seen, [pictures, job.began], () => pictures.map((file) => h("figure", {}, h("img", { src: `${file}?of=${encodeURIComponent(job.began ?? "")}`, alt: "The exported material next to the fitted one" }), h("figcaption", {}, "the fitted material, the exported one, their difference, and 18% grey"))));
    // An export says little, and all of it matters: how far the material is from the fit, or why there is none.
    const lines = job.log ?? [];
    const short = job.kind === "export" && !running;
    redraw(said, short ? lines : [], () => (short ? lines.map((line) => h("li", { class: /^(warning|error)/.test(line) ? "warn" : null }, line)) : []));
    say(log, lines.join("\n"));
    logBox.hidden = short;
    logBox.open ||= job.state === "failed";
  }
  return { element, show };
}
