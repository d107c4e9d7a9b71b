// @ts-check
/** What the page calls the options of each kind of job: on its fields, and in what the studio says. */

import { get } from "./api.js";
import { field } from "./dom.js";

/** @typedef {{label: string, help: string, role: string, group: string, default: string, choices: string[]}} Declaration */

/** @type {Record<string, Record<string, Declaration>>} by kind of job, then by option */
let known = {};

/** The options as the jobs declare them; they come when the studio's process for jobs has started. */
export const declarations = get("api/jobs/options").then(({ kinds }) => {
  known = kinds;
}, () => {});

/** What a job declares of an option. @param {string} kind @param {string} option @returns {Declaration} */
export const declared = (kind, option) => known[kind]?.[option] ?? { label: "", help: "", role: "value", group: "", default: "", choices: [] };

/** The options of a job that the page has a control for: values with a label. @param {string} kind */
export const labelled = (kind) => Object.entries(known[kind] ?? {}).filter(([, { label, role }]) => label && role === "value").map(([name]) => name);

/** What the page calls an option. @param {string} kind @param {string} option */
export const label = (kind, option) => known[kind]?.[option]?.label || option.replaceAll("_", " ");

/**
 * An option's control with its name, and its help where one points at it.
 *
 * @param {string} kind
 * @param {string} option
 * @param {HTMLElement} control
 */
export function option(kind, option, control) {
  const element = field(label(kind, option), control);
  element.title = worded(kind, known[kind]?.[option]?.help ?? "");
  return element;
}

/**
 * What the studio says of a job, with the page's fields in place of the command's options.
 *
 * @param {string} kind of the job
 * @param {string} text
 */
export function worded(kind, text) {
  const name = (/** @type {string} */ option) => known[kind]?.[option]?.label;
  return text
    .replace(/--([a-z][a-z-]*[a-z])/g, (flag, option) => {
      const called = name(option.replaceAll("-", "_"));
      return called ? `“${called}”` : `${flag} of the command line`;
    })
    .replace(/(^|; )([a-z_]+)(?= is )/g, (whole, before, option) => (name(option) ? `${before}“${name(option)}”` : whole));
}
