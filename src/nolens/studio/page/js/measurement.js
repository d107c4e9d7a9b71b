// @ts-check
/** One measurement on the page: what is measured, its button, its job and what it found. */

import { cameraChoice, offerFiles } from "./choices.js";
import { button, field, fill, group, h, segments, setOptions } from "./dom.js";
import { fileLinks, JobView } from "./jobs.js";
import { told } from "./notices.js";

/** @typedef {import("./jobs.js").Job} Job */

/** A card of the panel. */
export class Measurement {
  /**
   * @param {{title: string, about: string, name: string, kind: string, controls: HTMLElement[],
   *   options: () => Record<string, unknown>, found: (job: Job) => (Node | null)[]}} given
   *   `name`: of the card, under which a reload finds its job
   */
  constructor(given) {
    this.given = given;
    this.job = new JobView({ keep: given.name });
    this.result = h("div", { class: "stage" });
    this.maker = button("Measure", told(() => this.measure()), { class: "primary" });
    this.element = group(given.title, h("p", { class: "pale" }, given.about), ...given.controls,
      h("div", { class: "row" }, this.maker), this.job.element, this.result);
    this.element.dataset.measure = given.name;
    told(async () => this.show(await this.job.again()))();
  }

  async measure() {
    const options = this.given.options();
    this.maker.disabled = true;
    fill(this.result);
    try {
      this.show(await this.job.run(this.given.kind, options));
      // A card with a plot is as wide as the page, and so lies elsewhere.
      this.result.scrollIntoView({ block: "nearest" });
    } finally {
      this.maker.disabled = false;
    }
  }

  /** @param {Job | null} job */
  show(job) {
    if (job) fill(this.result, ...this.given.found(job), fileLinks(job.outputs ?? []));
  }
}

/** A target in a simulation of a camera, or in a picture that a camera took. */
export class Target {
  /**
   * @param {{picture: string, simulated?: HTMLElement[], pictured?: HTMLElement[]}} given
   *   `picture`: what the picture shows; controls that only a simulation has, or only a picture
   */
  constructor({ picture, simulated = [], pictured = [] }) {
    this.what = picture;
    this.camera = h("select", {});
    this.file = h("select", {});
    this.parts = {
      simulation: h("div", { class: "fields" }, ...simulated),
      picture: h("div", { class: "fields" }, field("Picture", this.file), ...pictured),
    };
    this.way = segments(`Where the ${picture} is`, [["simulation", "Simulation"], ["picture", "A picture"]],
      "simulation", () => this.follow());
    this.elements = [this.way.element, field("Camera", this.camera), this.parts.simulation, this.parts.picture];
    this.follow();
  }

  get simulated() {
    return this.way.value() === "simulation";
  }

  follow() {
    this.parts.simulation.hidden = !this.simulated;
    this.parts.picture.hidden = this.simulated;
  }

  /** The picture that is chosen. */
  get path() {
    if (!this.file.value) {
      throw new Error(`There is no picture of the ${this.what} yet: photograph one and reconstruct it (key 4), and choose its .tif here.`);
    }
    return this.file.value;
  }

  /** @param {import("./choices.js").Camera[]} cameras @param {import("./choices.js").Group[]} pictures */
  offer(cameras, pictures) {
    offerCameras(this.camera, cameras);
    offerFiles(this.file, pictures, pictures.length ? "Choose a picture" : "None yet: reconstruct one");
  }
}

/** Cameras to simulate; the smallest at first, which is done soonest. @param {HTMLSelectElement} select @param {import("./choices.js").Camera[]} cameras */
export function offerCameras(select, cameras) {
  const first = !select.value;
  setOptions(select, cameras.map(cameraChoice));
  if (first && cameras.some(({ id }) => id === "small")) select.value = "small";
}
