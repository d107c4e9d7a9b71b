// @ts-check
/** Figures and plots of measurements. */

import { fileUrl } from "./api.js";
import { h } from "./dom.js";
import { mm, number, percent } from "./format.js";

/** @param {number | null | undefined} value @param {(value: number) => string} text */
export const known = (value, text) => (typeof value === "number" ? text(value) : "–");

/** The plot among a job's files. @param {import("./jobs.js").Job} job @param {string} [alt] */
export function jobPlot(job, alt = "Plot of the measurement") {
  const path = (job.outputs ?? []).find((each) => each.endsWith(".png"));
  return path ? h("img", { class: "wide", src: fileUrl(path), alt }) : h("p", {}, "There is no plot.");
}

/** @param {import("./jobs.js").Job} job */
export const psfPlot = (job) => jobPlot(job, "Plots of the PSF: its pattern, autocorrelation and spectrum");

const um = (/** @type {number} */ value) => `${number(value)} µm`;

/** What `measure psf` found, as rows. @param {any} found @returns {[string, string][]} */
export const psfFigures = (found) => [
  ["Line width (FWHM)", known(found.line_width_um, um)],
  ["Pitch", known(found.pitch_um, um)],
  ["Cell", known(found.cell_um, um)],
  ["Contrast", known(found.contrast, (value) => number(value))],
  ["Numerical aperture", known(found.lenslet_aperture, (value) => number(value))],
  ["Depth of focus", known(found.depth_of_focus_mm, mm)],
  ["Mask to sensor, as in air", known(found.reduced_thickness_mm, mm)],
];

const degrees = (/** @type {number} */ value) => `${number(value)}°`;

/** What `measure resolution two-points` found. @param {any} found @returns {[string, string][]} */
export const twoPointRows = (found) => [
  ["Resolved from", known(found.resolved_deg, degrees)],
  ["Uncertain by ±", known(found.plus_minus_deg, degrees)],
  ["Dip that counts", known(found.dip_needed, (value) => percent(value, 3))],
  ...found.separations.map((/** @type {any} */ each) =>
    [`Dip at ${degrees(each.separation_deg)}`, `${known(each.dip, (value) => percent(value, 3))}${each.resolved ? "" : ", not resolved"}`]),
];

/** What `measure field` found of PSFs from the side. @param {any} found */
export const fieldRows = (found) => h("div", { class: "scroll" }, h("table", { class: "figures" },
  h("caption", { class: "unseen" }, "PSFs from the side"),
  h("thead", {}, h("tr", {}, ["Half angle", "Correlation", "Of the overlap", "Light"].map((name) => h("th", { scope: "col" }, name)))),
  h("tbody", {}, found.angles.map((/** @type {any} */ each) => h("tr", {},
    h("th", { scope: "row" }, degrees(each.angle_deg)),
    h("td", {}, known(each.correlation, (value) => value.toFixed(3))),
    h("td", {}, known(each.correlation_overlap, (value) => value.toFixed(3))),
    h("td", {}, known(each.light, (value) => percent(value, 3))))))));
