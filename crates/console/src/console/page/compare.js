// Two or more fits against each other, of any sessions: how far they are apart, curves, pictures.

import { ask } from "./api.js";
import { curvePanel } from "./curves.js";
import { facts, field, h, panel, redraw, say } from "./dom.js";
import { digits, short, when } from "./format.js";
import { complain } from "./notices.js";
import { slowPicture } from "./picture.js";
import { fileOf, warningList } from "./session.js";
import { badge, done, latest } from "./verdict.js";

const LETTERS = ["A", "B", "C", "D"];

/** The part of the view; `load([fit, fit, …])`, each "NAME" or "NAME:FIT". */
export function comparePart() {
  const sides = LETTERS.map(side);
  const apart = h("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Table of differences" });
  const status = h("p", { class: "fine", role: "status" });
  const curves = curvePanel(LETTERS);
  const table = h("div", { class: "compare-pictures" });
  const more = h("button", { type: "button", id: "add-fit" }, "Add a fit");
  const element = h(
    "div",
    { class: "stack" },
    h("p", {}, h("a", { href: "#sessions" }, "← All sessions")),
    h("div", { class: "row" }, h("h3", {}, "Fits against each other"), more),
    h("div", { class: "two even" }, sides.map((one) => one.element)),
    panel("How far they are apart", { id: "apart" }, status, apart),
    curves.element,
    panel("Pictures", {}, table),
  );
  let fitted = [];
  let request = null;

  async function load(names) {
    try {
      const sessions = await ask("api/sessions?search=");
      fitted = sessions.filter((session) => session.fits?.length);
      const wanted = [...names, ...Array(Math.max(0, 2 - names.length)).fill(null)].slice(0, LETTERS.length);
      await Promise.all(sides.map((one, i) => (i < wanted.length ? one.offer(fitted, wanted[i]) : one.hide())));
      draw();
    } catch (error) {
      complain(error);
    }
  }

  /** What is compared: the letters' fits that are shown. */
  function draw() {
    const shown = sides.filter((one) => one.chosen());
    more.hidden = shown.length >= LETTERS.length || fitted.length === 0;
    for (const one of sides) one.leave.hidden = shown.length <= 2;
    measure(shown.map((one) => one.chosen()));
    const pictures = shown.map((one) => one.pictures());
    const captions = [...new Set(pictures.flatMap((of) => [...of.keys()]))];
    redraw(table, captions.map((caption) => pictures.map((of) => of.get(caption) ?? null)), () =>
      captions.map((caption) =>
        h(
          "figure",
          {},
          h("div", { class: "pair" }, pictures.map((of, i) => h("div", {}, h("p", { class: "letter" }, LETTERS[i]), of.has(caption) ? slowPicture(of.get(caption), { alt: `${LETTERS[i]}: ${caption}`, class: "pixels" }) : h("p", { class: "fine" }, "none")))),
          h("figcaption", {}, caption),
        ),
      ),
    );
  }

  async function measure(fits) {
    request?.abort();
    request = new AbortController();
    const mine = request;
    say(status, "Comparing …");
    try {
      const compared = await ask(`api/compare?fits=${fits.map(encodeURIComponent).join("/")}`, mine.signal);
      if (mine !== request) return;
      say(status, "");
      redraw(apart, compared.pairs, () => [pairTable(compared.pairs)]);
      curves.show(compared.fits);
    } catch (error) {
      if (error.name === "AbortError") return;
      say(status, error.message);
      redraw(apart, [], () => []);
      curves.show([]);
      complain(error);
    }
  }

  function changed() {
    const names = sides.map((one) => one.chosen()).filter(Boolean).map(encodeURIComponent);
    history.replaceState(null, "", `#sessions/compare/${names.join("/")}`);
    draw();
  }
  for (const one of sides) one.onchange = changed;
  // Letters have no gaps: the fits behind one that is left move up.
  sides.forEach((one, i) =>
    one.leave.addEventListener("click", () => {
      const names = sides.map((each) => each.chosen()).filter(Boolean);
      names.splice(i, 1);
      location.hash = `#sessions/compare/${names.map(encodeURIComponent).join("/")}`;
    }),
  );
  more.addEventListener("click", () => {
    const names = sides.map((each) => each.chosen()).filter(Boolean);
    const all = fitted.flatMap((session) => [...session.fits].reverse().map((fit) => `${session.name}:${fit.name}`));
    const next = all.find((fit) => !names.includes(fit)) ?? all[0];
    location.hash = `#sessions/compare/${[...names, next].map(encodeURIComponent).join("/")}`;
  });
  return { element, load };
}

/** One number for each two fits, and one in units of what is known. */
function pairTable(pairs) {
  const columns = ["Fits", "Environment error", "Difference in f"];
  const rows = pairs.map((pair) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, `${LETTERS[pair.with]} against ${LETTERS[pair.of]}`),
      h("td", {}, `${digits(100 * pair.environment_error, 2)}%`),
      h("td", {}, pair.in_uncertainties === null ? "–" : `${digits(pair.in_uncertainties, 2)} standard uncertainties`),
    ),
  );
  return h(
    "table",
    {},
    h("caption", { class: "fine" }, "Environment error: the relative difference of spheres lit by environment maps. Difference in f: root mean square over the angles that the images of both constrain, divided by the standard uncertainty of the difference; about 1 or less is agreement."),
    h("thead", {}, h("tr", {}, columns.map((name) => h("th", { scope: "col" }, name)))),
    h("tbody", {}, rows),
  );
}

function side(letter) {
  const select = h("select", { "aria-label": `Fit ${letter}` });
  const list = h("dl", { class: "facts" });
  const settings = h("dl", { class: "facts" });
  const warnings = h("div");
  const verdict = h("p", { class: "verdict" });
  const leave = h("button", { type: "button", class: "quiet", "aria-label": `Leave out fit ${letter}` }, "Leave out");
  const element = h("section", { class: "panel", "aria-label": `Fit ${letter}`, hidden: true }, field(`Fit ${letter}`, select), verdict, list, h("details", {}, h("summary", {}, "Settings and warnings"), settings, warnings), leave);
  let session = null;
  let fit = null;

  async function choose() {
    const [name, number] = split(select.value);
    session = name ? await ask(`api/sessions/${encodeURIComponent(name)}`) : null;
    fit = session?.fits?.find((one) => one.name === number) ?? (session ? latest(session) : null);
    verdict.replaceChildren(badge(fit));
    facts(list, session ? [
      ["Sample", short(session.sample) ?? "–"],
      ["Captured", when(session.began)],
      ["Lights", done(session)],
      ["Dictionary", fit?.dictionary ?? "–"],
      ["χ²", Number.isFinite(fit?.chi2) ? digits(fit.chi2, 3) : "–"],
      ["Error against the truth", Number.isFinite(fit?.environment_error) ? `${digits(100 * fit.environment_error, 2)}%` : null],
    ] : []);
    facts(settings, Object.entries(fit?.settings ?? {}).filter(([key]) => key !== "Dictionary"));
    warnings.replaceChildren(warningList(fit?.warnings));
  }
  const part = {
    element,
    leave,
    onchange: () => {},
    /** "NAME:FIT", or null where this letter is not used. */
    chosen: () => (element.hidden ? null : select.value || null),
    /** By caption, the address. */
    pictures: () => new Map((fit?.pictures ?? []).map(({ name, caption }) => [caption, fileOf(session.name, name)])),
    hide() {
      element.hidden = true;
    },
    async offer(sessions, wanted) {
      element.hidden = false;
      const options = sessions.flatMap((one) => [...one.fits].reverse().map((each) => [`${one.name}:${each.name}`, `${one.sample || one.name}, ${when(one.began)}, fit ${each.name}`]));
      const before = select.value;
      redraw(select, options, () => options.map(([value, text]) => h("option", { value }, text)));
      const [name, number] = split(wanted ?? before ?? "");
      const match = options.find(([value]) => value === `${name}:${number}`) ?? options.find(([value]) => value.startsWith(`${name}:`));
      if (match) select.value = match[0];
      await choose();
    },
  };
  select.addEventListener("change", async () => {
    try {
      await choose();
      part.onchange();
    } catch (error) {
      complain(error);
    }
  });
  return part;
}

function split(value) {
  const colon = value.lastIndexOf(":");
  return colon < 0 ? [value, null] : [value.slice(0, colon), value.slice(colon + 1)];
}
