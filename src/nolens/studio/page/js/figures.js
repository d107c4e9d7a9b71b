// @ts-check
/** Figures and plots of measurements. */

import { fileUrl } from "./api.js";
import { h } from "./dom.js";
import { isDark } from "./jobs.js";
import { mm, number, percent } from "./format.js";

/** @param {number | null | undefined} value @param {(value: number) => string} text */
export const known = (value, text) => (typeof value === "number" ? text(value) : "–");

/** The plot among a job's files, for the light theme and the dark one. @param {import("./jobs.js").Job} job @param {string} [alt] */
export function jobPlot(job, alt = "Plot of the measurement") {
  const path = (job.outputs ?? []).find((each) => each.endsWith(".png") && !isDark(each));
  if (!path) return h("p", {}, "There is no plot.");
  const dark = (job.outputs ?? []).find(isDark);
  const image = (/** @type {string} */ source, /** @type {string} */ theme) =>
    h("a", { class: `plot ${theme}`, href: fileUrl(source), target: "_blank", rel: "noopener", title: "Open the plot by itself" },
      h("img", { class: "wide", loading: "lazy", src: fileUrl(source), alt }));
  return h("div", {}, dark ? [image(path, "for-light"), image(dark, "for-dark")] : image(path, ""));
}

/** @param {import("./jobs.js").Job} job */
export const psfPlot = (job) => jobPlot(job, "Plots of the PSF: the PSF itself, its autocorrelation and its spectrum");

const um = (/** @type {number} */ value) => `${number(value)} µm`;

/** What `measure psf` found, as rows. @param {any} found @returns {[string, string][]} */
export const psfFigures = (found) => [
  ["Line width (FWHM)", known(found.line_width_um, um)],
  ["Pitch", known(found.pitch_um, um)],
  ["Pixel", known(found.pixel_um, um)],
  ["Contrast", known(found.contrast, (value) => number(value))],
  ["Numerical aperture", known(found.lenslet_aperture, (value) => number(value))],
  ["Depth of focus", known(found.depth_of_focus_mm, mm)],
  ["Reduced thickness, mask to sensor", known(found.reduced_thickness_mm, mm)],
];

const degrees = (/** @type {number} */ value) => `${number(value)}°`;

/** What `measure resolution two-points` found. @param {any} found @returns {[string, string][]} */
export const twoPointRows = (found) => [
  ["Resolved from", known(found.resolved_deg, degrees)],
  ["Uncertainty ±", known(found.plus_minus_deg, degrees)],
  ["Smallest significant dip", known(found.dip_needed, (value) => percent(value, 3))],
  ...found.separations.map((/** @type {any} */ each) =>
    [`Dip at ${degrees(each.separation_deg)}`, `${known(each.dip, (value) => percent(value, 3))}${each.resolved ? "" : ", not resolved"}`]),
];

/** What `measure resolution siemens` found. @param {any} found @returns {[string, string][]} */
export const starRows = (found) => [
  ["Resolved in all directions from", `${known(found.resolved_deg, degrees)}${found.finest_of_the_pixels ? ", the finest that the pixels show" : ""}`],
  ["Uncertainty ±", known(found.plus_minus_deg, degrees)],
  ["Worst direction", known(found.worst_direction_deg, degrees)],
  ["Contrast threshold", known(found.contrast_needed, (value) => percent(value, 3))],
  ["Spokes", String(found.spokes)],
  ["Field angle of the star", known(found.diameter_deg, degrees)],
];

const perDegree = (/** @type {number} */ value) => `${number(value)} per degree`;

/** What `measure resolution edge` found. @param {any} found @returns {[string, string][]} */
export const edgeRows = (found) => [
  ["Resolved from (10 % contrast)", known(found.resolved_deg, degrees)],
  ["Half of the contrast (MTF50) at", known(found.half_contrast_per_deg, perDegree)],
  ["A tenth of the contrast (MTF10) at", known(found.tenth_contrast_per_deg, perDegree)],
  ["Edge tilted by", known(found.tilt_deg, degrees)],
];

/** What `measure field` found of a grid of dots. @param {any} found @returns {[string, string][]} */
export const dotRows = (found) => [
  ["Clear up to a half angle of", known(found.good_deg, degrees)],
  ["Visible up to", known(found.distorted_deg, degrees)],
  ["Lost from", found.lost_deg === null ? "nowhere among these dots" : degrees(found.lost_deg)],
  ["Dots", String(found.dots.length)],
  ["Measured pitch", known(found.measured_pitch_mm, mm)],
  ["Field angle of a pixel in the middle", known(found.pixel_deg, degrees)],
];

/** What `measure field` found of PSFs from the side. @param {any} found */
export const fieldRows = (found) => h("div", { class: "scroll" }, h("table", { class: "figures" },
  h("caption", { class: "unseen" }, "Off-axis PSFs"),
  h("thead", {}, h("tr", {}, ["Half angle", "Correlation", "Of the overlap", "Light"].map((name) => h("th", { scope: "col" }, name)))),
  h("tbody", {}, found.angles.map((/** @type {any} */ each) => h("tr", {},
    h("th", { scope: "row" }, degrees(each.angle_deg)),
    h("td", {}, known(each.correlation, (value) => value.toFixed(3))),
    h("td", {}, known(each.correlation_overlap, (value) => value.toFixed(3))),
    h("td", {}, known(each.light, (value) => percent(value, 3))))))));
