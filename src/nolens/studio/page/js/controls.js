// @ts-check
/** Controls for options, made from what their jobs declare. */

import { freshId, h, slider, tick } from "./dom.js";
import { number } from "./format.js";
import { declared, label, labelled, option, worded } from "./names.js";

/** @typedef {{element: HTMLElement, value: () => unknown, set: (value: unknown) => void, select?: HTMLSelectElement}} Control a value is undefined where the option is left out */
/** @typedef {{words?: Record<string, string>, example?: string}} Words `words`: what the page calls the choices; `example`: of a text */

const LONGEST = 34;
/** @type {Record<string, unknown>} */
const SWITCH = { on: true, off: false };

/** @param {HTMLInputElement} input */
const text = (input) => input.value.trim() || undefined;

/** A number where it is one; else the text, which the studio then says more about. @param {HTMLInputElement} input */
const value = (input) => {
  const given = text(input);
  return given === undefined || Number.isNaN(Number(given)) ? given : Number(given);
};

/**
 * A control for an option of a job.
 *
 * @param {string} kind of the job
 * @param {string} name
 * @param {Words} [more]
 * @returns {Control}
 */
export function control(kind, name, { words = {}, example } = {}) {
  const { choices, default: normal } = declared(kind, name);
  if (choices.join() === "on,off" && !normal) {
    const { box, element } = tick(label(kind, name), false);
    return { element, value: () => box.checked || undefined, set: (value) => { box.checked = value === true; } };
  }
  const list = choices.length ? choices : Object.keys(words);
  if (list.length) {
    const said = (/** @type {string} */ choice) => words[choice] ?? `${choice[0].toUpperCase()}${choice.slice(1)}`;
    const chosen = choices.includes(normal);
    const select = h("select", {}, !chosen && h("option", { value: "" }, words[""] ?? `By default (${worded(kind, normal)})`),
      ...list.map((each) => h("option", { value: each }, said(each))));
    const usual = chosen ? normal : "";
    select.value = usual;
    return {
      element: option(kind, name, select), value: () => (select.value === usual ? undefined : SWITCH[select.value] ?? select.value), select,
      set: (value) => {
        const given = value === undefined ? usual : value === true ? "on" : value === false ? "off" : String(value);
        select.value = given;
        // A file that is in no folder here: the studio says so when it is asked for.
        if (select.selectedIndex < 0) select.append(h("option", { value: given, selected: true }, given));
      },
    };
  }
  const usual = worded(kind, normal);
  const input = h("input", { type: "text", spellcheck: false, placeholder: example ?? (usual.length <= LONGEST ? usual : "by default") });
  return { element: option(kind, name, input), value: () => value(input), set: (given) => { input.value = given === undefined ? "" : String(given); } };
}

/** How much detail: a factor on the automatic weight of the prior, from an eighth to eight times. @param {(detail: number) => void} [input] */
export const detailSlider = (input) => slider({
  label: "Detail", min: 1 / 8, max: 8, value: 1, log: true, input,
  text: (detail) => (Math.abs(Math.log2(detail)) < 0.01 ? "automatic" : detail > 1 ? `${number(detail, 2)} × finer` : `${number(1 / detail, 2)} × smoother`),
});

/**
 * Fields of a job's options: at first those that most people need, the others under "More" by their groups.
 *
 * @param {string} kind of the job
 * @param {Record<string, HTMLElement[]>} fields what belongs to an option, by its name
 */
export function form(kind, fields) {
  /** @type {HTMLElement[]} */
  const basic = [];
  /** @type {Map<string, HTMLElement[]>} */
  const groups = new Map();
  for (const [name, elements] of Object.entries(fields)) {
    const { group } = declared(kind, name);
    if (group) groups.set(group, [...groups.get(group) ?? [], ...elements]);
    else basic.push(...elements);
  }
  if (groups.size === 0) return basic;
  const sections = [...groups].map(([title, elements]) => {
    const id = freshId("group");
    return h("section", { class: "fields", "aria-labelledby": id }, h("h3", { id }, title), ...elements);
  });
  return [...basic, h("details", {}, h("summary", {}, "More"), ...sections)];
}

/** The form of a job: fields that a panel makes itself, and a control for every other value that the page has a name for. */
export class JobForm {
  /**
   * @param {string} kind of the job
   * @param {{own?: Record<string, HTMLElement[]>, without?: string[], more?: Record<string, Words>}} [given]
   *   `own`: the panel's fields by option; `without`: options that it has elsewhere, or not at all
   */
  constructor(kind, { own = {}, without = [], more = {} } = {}) {
    const names = labelled(kind).filter((name) => !(name in own) && !without.includes(name));
    this.controls = Object.fromEntries(names.map((name) => [name, control(kind, name, more[name])]));
    this.elements = form(kind, { ...own, ...Object.fromEntries(names.map((name) => [name, [this.controls[name].element]])) });
  }

  values() {
    return Object.fromEntries(Object.entries(this.controls).map(([name, each]) => [name, each.value()]));
  }
}
