// @ts-check
/** Measure: how good a camera is, as plots and figures. */

import { calibratedCameras, cameras, filesBy, psfChoices } from "./choices.js";
import { JobForm } from "./controls.js";
import { figureTable, fill, h, segments, setOptions } from "./dom.js";
import { dotRows, edgeRows, fieldRows, jobPlot, psfFigures, psfPlot, starRows, twoPointRows } from "./figures.js";
import { Measurement, offerCameras, Target } from "./measurement.js";
import { option } from "./names.js";
import { told } from "./notices.js";

const POINTS = "measure-two-points";
const FIELD = "measure-field";
/** Options of raw frames, which the page measures when they have become pictures. */
const FRAMES = ["psf_extent"];
/** @type {Record<string, import("./controls.js").Words>} what the page adds to the declarations */
const MORE = { distance: { example: "the camera's own" } };

/** Pictures in linear light, as reconstructions are kept. @param {{name: string}} entry */
const linear = ({ name }) => /\.(tiff?|npy)$/i.test(name);

/** @param {Record<string, unknown>} [more] */
const typed = (more = {}) => h("input", { type: "text", spellcheck: false, ...more });

/** @param {HTMLInputElement} input */
const text = (input) => input.value.trim() || undefined;

/** A PSF that was calibrated. */
function psfCard() {
  const psf = h("select", {});
  const form = new JobForm("measure-psf", { own: { psf: [option("measure-psf", "psf", psf)] } });
  const card = new Measurement({
    title: "PSF", name: "psf", kind: "measure-psf", controls: form.elements,
    about: "Line width, pitch, autocorrelation and spectrum of a PSF.",
    options: () => {
      if (!psf.value) throw new Error("There is no PSF yet: calibrate the camera (key 3), or save a raw frame on the Viewfinder (key s).");
      return { psf: psf.value, ...form.values() };
    },
    found: (job) => [psfPlot(job), figureTable(psfFigures(job.summary), "Figures of the PSF")],
  });
  return { card, psf };
}

/** Two point sources, nearer and nearer. */
function pointsCard() {
  const camera = h("select", {});
  const draws = h("input", { type: "number", min: 1, max: 20, value: 1 });
  const form = new JobForm(POINTS, { without: FRAMES, more: MORE,
    own: { simulate: [option(POINTS, "simulate", camera)], draws: [option(POINTS, "draws", draws)] } });
  const card = new Measurement({
    title: "Two points", name: "two-points", kind: "measure-two-points",
    about: "The smallest separation at which two point sources are resolved, in a simulation of the camera.",
    controls: form.elements,
    options: () => ({ simulate: camera.value, draws: Number(draws.value) || 1, ...form.values() }),
    found: (job) => [jobPlot(job, "Dip between two points by their separation"),
      figureTable(twoPointRows(job.summary), "Resolution of two points")],
  });
  return { card, camera };
}

/**
 * A target of which one picture is measured.
 *
 * @param {{title: string, kind: string, about: string, picture: string, plot: string, angle: string,
 *   rows: (found: any) => [string, string][]}} given
 */
function targetCard({ title, kind, about, picture, plot, angle, rows }) {
  const wide = typed({ value: angle });
  const form = new JobForm(kind, { own: { angle: [option(kind, "angle", wide)] }, without: FRAMES, more: MORE });
  const target = new Target({ picture, simulated: form.elements });
  const card = new Measurement({
    title, kind, about, name: kind.replace("measure-", ""), controls: target.elements,
    options: () => (target.simulated
      ? { simulate: target.camera.value, angle: text(wide), ...form.values() }
      : { frames: [target.path], camera: target.camera.value }),
    found: (job) => [jobPlot(job, plot), figureTable(rows(job.summary), `Resolution of the ${picture}`)],
  });
  return { card, target };
}

/** PSFs from the side, of a simulated camera or of one that was calibrated so. */
function sideCard() {
  const camera = h("select", {});
  const folder = h("select", {});
  const angles = typed({ value: "0deg,10deg,20deg,30deg,40deg" });
  const simulated = h("div", { class: "fields" }, option(FIELD, "simulate", camera), option(FIELD, "angles", angles));
  const captured = h("div", { class: "fields", hidden: true }, option(FIELD, "psfs", folder));
  const way = segments("Source of the PSFs", [["simulation", "Simulation"], ["captured", "Captured PSFs"]],
    "simulation", (chosen) => { simulated.hidden = chosen !== "simulation"; captured.hidden = !simulated.hidden; });
  const card = new Measurement({
    title: "Field of view", name: "field", kind: "measure-field",
    about: "How similar off-axis PSFs are to the one on the axis.",
    controls: [way.element, simulated, captured],
    options: () => {
      if (way.value() === "simulation") return { simulate: camera.value, angles: text(angles) };
      if (!folder.value) throw new Error("No camera has PSFs yet: calibrate one (key 3).");
      return { psfs: folder.value };
    },
    found: (job) => [jobPlot(job, "Correlation of the PSFs by angle"), fieldRows(job.summary)],
  });
  return { card, camera, folder };
}

/** A grid of dots. */
function dotsCard() {
  const pitch = typed({ value: "20mm" });
  const distance = typed({ value: "300mm" });
  const extent = typed({ value: "30deg" });
  const target = new Target({ picture: "grid of dots", simulated: [option(FIELD, "extent", extent)] });
  const card = new Measurement({
    title: "Dot grid", name: "dots", kind: "measure-field",
    about: "Up to which field angle a grid of dots stays clear, and where it is lost.",
    controls: [...target.elements, h("div", { class: "row" },
      h("div", { class: "grow" }, option(FIELD, "dot_pitch", pitch)),
      h("div", { class: "grow" }, option(FIELD, "distance", distance)))],
    options: () => {
      const grid = { dot_pitch: text(pitch), distance: text(distance) };
      return target.simulated ? { simulate: target.camera.value, extent: text(extent), ...grid }
        : { dots: target.path, camera: target.camera.value, ...grid };
    },
    found: (job) => [jobPlot(job, "Dots by their grade and angle"), figureTable(dotRows(job.summary), "Dot grid")],
  });
  return { card, target };
}

class Measure {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.psf = psfCard();
    this.points = pointsCard();
    this.star = targetCard({
      title: "Siemens star", kind: "measure-siemens", picture: "star", angle: "20deg", rows: starRows,
      about: "The finest spokes of a Siemens star that are resolved in all directions.",
      plot: "Contrast of the star's spokes by their width",
    });
    this.edge = targetCard({
      title: "Slanted edge", kind: "measure-edge", picture: "edge", angle: "10deg", rows: edgeRows,
      about: "How contrast falls with spatial frequency (MTF), from one straight edge.",
      plot: "Contrast across the edge by frequency",
    });
    this.side = sideCard();
    this.dots = dotsCard();
    const cards = [this.psf, this.points, this.star, this.edge, this.side, this.dots];
    fill(place, h("h1", { class: "unseen" }, "Measure"),
      h("div", { class: "three wide" }, ...cards.map(({ card }) => card.element)));
  }

  enter() {
    told(async () => {
      const [all, psfs, folders, pictures] = await Promise.all([
        cameras(), psfChoices(), calibratedCameras(), filesBy(linear)]);
      setOptions(this.psf.psf, psfs.length ? psfs : [{ value: "", label: "None yet: calibrate a camera" }]);
      setOptions(this.side.folder, folders.length ? folders : [{ value: "", label: "None yet: calibrate a camera" }]);
      for (const { camera } of [this.points, this.side]) offerCameras(camera, all);
      for (const { target } of [this.star, this.edge, this.dots]) target.offer(all, pictures);
    })();
  }
}

/** @param {HTMLElement} place */
export const measurePanel = (place) => new Measure(place);
