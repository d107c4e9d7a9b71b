// @ts-check
/** Measure: how good a camera is, as plots and figures. */

import { cameraChoice, cameras, psfChoices } from "./choices.js";
import { button, field, figureTable, fill, group, h, setOptions } from "./dom.js";
import { fieldRows, jobPlot, psfFigures, psfPlot, twoPointRows } from "./figures.js";
import { fileLinks, JobView } from "./jobs.js";
import { told } from "./notices.js";

/** @typedef {import("./jobs.js").Job} Job */

/** One measurement: what it is told, its button, its job and what it found. */
class Measurement {
  /**
   * @param {{title: string, about: string, kind: string, controls: HTMLElement[],
   *   options: () => Record<string, unknown>, found: (job: Job) => (Node | null)[]}} given
   */
  constructor(given) {
    this.given = given;
    this.job = new JobView({ keep: given.kind });
    this.result = h("div", { class: "stage" });
    this.maker = button("Measure", told(() => this.measure()), { class: "primary" });
    this.element = group(given.title, h("p", { class: "pale" }, given.about), ...given.controls,
      h("div", { class: "row" }, this.maker), this.job.element, this.result);
    this.element.dataset.kind = given.kind;
    told(async () => this.show(await this.job.again()))();
  }

  async measure() {
    const options = this.given.options();
    this.maker.disabled = true;
    fill(this.result);
    try {
      this.show(await this.job.run(this.given.kind, options));
    } finally {
      this.maker.disabled = false;
    }
  }

  /** @param {Job | null} job */
  show(job) {
    if (job) fill(this.result, ...this.given.found(job), fileLinks(job.outputs ?? []));
  }
}

class Measure {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.psf = h("select", {});
    this.pointCamera = h("select", {});
    this.pointDistance = h("input", { type: "text", placeholder: "the camera's own", spellcheck: false });
    this.draws = h("input", { type: "number", min: 1, max: 20, value: 1 });
    this.fieldCamera = h("select", {});
    this.angles = h("input", { type: "text", value: "0deg,10deg,20deg,30deg,40deg", spellcheck: false });
    const psf = new Measurement({
      title: "PSF", kind: "measure-psf", controls: [field("PSF", this.psf)],
      about: "Line width, pitch, autocorrelation and transfer of a PSF.",
      options: () => {
        if (!this.psf.value) throw new Error("There is no PSF yet: calibrate the camera (key 3), or save a raw frame on the Viewfinder (key s).");
        return { psf: this.psf.value };
      },
      found: (job) => [psfPlot(job), figureTable(psfFigures(job.summary), "Figures of the PSF")],
    });
    const points = new Measurement({
      title: "Two points", kind: "measure-two-points",
      about: "How close two points of light may be and still be told apart, in a simulation of the camera.",
      controls: [field("Camera", this.pointCamera), h("div", { class: "row" },
        h("div", { class: "grow" }, field("Distance", this.pointDistance)),
        h("div", { class: "narrow" }, field("Repeats", this.draws)))],
      options: () => ({ simulate: this.pointCamera.value, distance: this.pointDistance.value.trim(), draws: Number(this.draws.value) || 1 }),
      found: (job) => [jobPlot(job, "Dip between two points by their separation"),
        figureTable(twoPointRows(job.summary), "Resolution of two points")],
    });
    const side = new Measurement({
      title: "Field of view", kind: "measure-field",
      about: "How alike the PSFs from the side are to the one from straight ahead, in a simulation of the camera.",
      controls: [field("Camera", this.fieldCamera), field("Half angles", this.angles)],
      options: () => ({ simulate: this.fieldCamera.value, angles: this.angles.value.trim() }),
      found: (job) => [jobPlot(job, "Correlation of the PSFs by angle"), fieldRows(job.summary)],
    });
    fill(place, h("h1", { class: "unseen" }, "Measure"), h("div", { class: "three wide" }, psf.element, points.element, side.element));
  }

  enter() {
    told(async () => {
      const [all, psfs] = await Promise.all([cameras(), psfChoices()]);
      setOptions(this.psf, psfs.length ? psfs : [{ value: "", label: "None yet: calibrate a camera" }]);
      const first = !this.pointCamera.value;
      for (const select of [this.pointCamera, this.fieldCamera]) {
        setOptions(select, all.map(cameraChoice));
        if (first && all.some(({ id }) => id === "small")) select.value = "small";
      }
    })();
  }
}

/** @param {HTMLElement} place */
export const measurePanel = (place) => new Measure(place);
