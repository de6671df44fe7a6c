// Two fits side by side, of any sessions.

import { ask } from "./api.js";
import { facts, field, h, redraw } from "./dom.js";
import { digits, short, when } from "./format.js";
import { complain } from "./notices.js";
import { fileOf, warningList } from "./session.js";
import { badge, latest } from "./verdict.js";

/** The part of the view; `load([session, session])`, each "NAME" or "NAME:FIT". */
export function comparePart() {
  const sides = [side("Left"), side("Right")];
  const table = h("div", { class: "compare-pictures" });
  const element = h("div", { class: "stack" }, h("p", {}, h("a", { href: "#sessions" }, "← All sessions")), h("h3", {}, "Two fits side by side"), h("div", { class: "two even" }, sides.map((one) => one.element)), table);

  async function load(names) {
    try {
      const sessions = await ask("api/sessions?search=");
      const fitted = sessions.filter((session) => session.fits?.length);
      await Promise.all(sides.map((one, i) => one.offer(fitted, names[i] ?? null)));
      pair();
    } catch (error) {
      complain(error);
    }
  }

  /** Pictures with the same caption stand next to each other. */
  function pair() {
    const [left, right] = sides.map((one) => one.pictures());
    const captions = [...new Set([...left.keys(), ...right.keys()])];
    redraw(table, captions.map((caption) => [left.get(caption), right.get(caption)]), () =>
      captions.map((caption) =>
        h("figure", {}, h("div", { class: "pair" }, [left, right].map((of, i) => (of.has(caption) ? h("img", { src: of.get(caption), alt: `${["left", "right"][i]}: ${caption}`, class: "pixels there", loading: "lazy" }) : h("div", { class: "empty" }, "none")))), h("figcaption", {}, caption)),
      ),
    );
  }
  for (const one of sides) {
    one.onchange = () => {
      const names = sides.map((each) => encodeURIComponent(each.chosen()));
      history.replaceState(null, "", `#sessions/compare/${names.join("/")}`);
      pair();
    };
  }
  return { element, load };
}

function side(label) {
  const select = h("select", { "aria-label": `${label} fit` });
  const list = h("dl", { class: "facts" });
  const warnings = h("div");
  const verdict = h("p", { class: "verdict" });
  const element = h("section", { class: "panel", "aria-label": label }, field(label, select), verdict, list, warnings);
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
      ["Lights", String(session.lights)],
      ["Dictionary", fit?.dictionary ?? "–"],
      ["χ²", Number.isFinite(fit?.chi2) ? digits(fit.chi2, 3) : "–"],
      ["Error against the truth", Number.isFinite(fit?.environment_error) ? `${digits(100 * fit.environment_error, 2)} %` : null],
      ...Object.entries(fit?.settings ?? {}).map(([key, value]) => [key.replaceAll("_", " "), String(value)]),
    ] : []);
    warnings.replaceChildren(warningList(fit?.warnings));
  }
  const part = {
    element,
    onchange: () => {},
    chosen: () => select.value,
    /** By caption, the address. */
    pictures: () => new Map((fit?.pictures ?? []).map(({ name, caption }) => [caption, fileOf(session.name, name)])),
    async offer(sessions, wanted) {
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
