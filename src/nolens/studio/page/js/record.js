// @ts-check
/** Records of results: what went in, what was chosen, and what came of it. */

import { fileUrl, get } from "./api.js";
import { button, figureTable, fill, group, h } from "./dom.js";
import { baseName, number } from "./format.js";
import { label } from "./names.js";
import { told } from "./notices.js";

/**
 * @typedef {object} RunRecord
 * @property {string} started
 * @property {Record<string, {path: string}>} inputs
 * @property {Record<string, any>} parameters
 * @property {Record<string, any>} result
 * @property {string[]} warnings
 */

/** Files, which have rows of their own, and what the studio chooses. */
const NO_SETTINGS = ["measurement", "psf", "psfs", "output", "camera"];
const METHODS = /** @type {Record<string, string>} */ ({ admm: "ADMM", "admm, plug-and-play": "ADMM, trained network", fista: "FISTA", wiener: "Wiener" });

/** A record, with the page's paths. @param {string} path @returns {Promise<RunRecord>} */
export const recordOf = async (path) => (await get(`api/record?path=${encodeURIComponent(path)}`)).record;

/** The options that were set, by name. @param {RunRecord} record */
export const settingsOf = ({ parameters, result }) => Object.fromEntries(
  // Records of the version before do not say what was set.
  (parameters.options_set ?? ["quality", "flip", "support", ...(result.default_tau === false ? ["tau"] : [])])
    .map((/** @type {string} */ name) => [name, parameters[name]])
    .filter((/** @type {[string, unknown]} */ [, value]) => value !== null && value !== undefined));

/** When a result was made. @param {string | number} time */
export const date = (time) => new Date(time).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

/** The main figures on one line. @param {RunRecord} record */
export function mainFigures({ result, parameters }) {
  const { method, iterations, frames = result.video?.frames, seconds } = result;
  const tau = result.tau ?? parameters.tau;
  return [
    METHODS[method ?? parameters.method] ?? method,
    iterations > 1 && `${iterations} iterations`,
    frames && `${frames} frames`,
    typeof tau === "number" && `τ ${number(tau, 2)}`,
    typeof seconds === "number" && `${number(seconds, 2)} s`,
  ].filter(Boolean).join(" · ");
}

/** A record under the picture that it belongs to, below the report of the picture. */
export class RecordView {
  /** @param {(record: RunRecord) => Promise<void>} use takes its settings again */
  constructor(use) {
    this.use = use;
    this.lines = h("div", {});
    this.report = group("Report", this.lines);
    this.report.classList.add("record", "report");
    this.element = h("details", { class: "group record", hidden: true });
  }

  /** @param {string | null} path of the record @param {boolean} [open] */
  async show(path, open = false) {
    this.element.hidden = this.report.hidden = true;
    if (!path) return;
    const record = await recordOf(path);
    const { inputs, result, parameters, warnings } = record;
    /** @type {[string, string][]} of records since they have it */
    const lines = result.report?.lines ?? [];
    fill(this.lines, figureTable(lines.map(([name, text]) => [name[0].toUpperCase() + name.slice(1), text]), "Report of the picture"));
    this.report.hidden = lines.length === 0;
    const settings = Object.entries(settingsOf(record)).filter(([name]) => !NO_SETTINGS.includes(name) && !(name in inputs))
      .map(([name, value]) => `${label("reconstruct", name)}: ${value}`);
    /** @type {[string, import("./dom.js").Child][]} */
    const rows = [
      ["Made", date(record.started)],
      ...Object.entries(inputs).map(([role, { path: file }]) => /** @type {[string, string]} */ ([label("reconstruct", role), baseName(file)])),
      ["Settings", settings.join("; ") || "all by default"],
      ["Result", mainFigures(record)],
      ["Ended", String(result.stop_reason ?? "–")],
      ["Objective", typeof result.objective === "number" ? number(result.objective, 4) : "–"],
      ["Pixels binned", `${parameters.bin ?? 1} × ${parameters.bin ?? 1}`],
    ];
    fill(this.element, h("summary", {}, "Record"), figureTable(rows, "Record of the result"),
      warnings.map((text) => h("p", { class: "warning" }, text)),
      h("div", { class: "row" },
        inputs.measurement && inputs.psf && button("Use these settings again", told(() => this.use(record))),
        h("a", { href: fileUrl(path), download: baseName(path) }, baseName(path))));
    this.element.open = open;
    this.element.hidden = false;
  }
}
