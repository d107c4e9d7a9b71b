// @ts-check
/** PSFs that were measured elsewhere, as files: into the folder of the camera that is calibrated. */

import { onDisk, upload } from "./api.js";
import { JobForm } from "./controls.js";
import { button, field, figureTable, fill, group, h } from "./dom.js";
import { folderOf } from "./format.js";
import { fileLinks, JobView } from "./jobs.js";
import { option } from "./names.js";
import { told } from "./notices.js";

const KIND = "calibrate-import";
/** @type {Record<string, import("./controls.js").Words>} what the page adds to the declarations */
const MORE = {
  sensor: { example: "rows x columns, such as 1464x1936" },
  psf_extent: { words: { sensor: "No: as large as the sensor", wide: "Yes: with the light beside the sensor" } },
  centre: { words: { file: "The middle of the file", light: "Where its light is" } },
};

export class PsfImport {
  /** @param {() => {name: string, camera: string}} into the folder, and the description of its camera */
  constructor(into) {
    this.into = into;
    this.files = h("input", { type: "file", multiple: true });
    this.distance = h("input", { type: "text", value: "300mm", spellcheck: false });
    this.form = new JobForm(KIND, { own: { distance: [option(KIND, "distance", this.distance)] }, without: ["name"], more: MORE });
    this.maker = button("Import", told(() => this.make()));
    this.job = new JobView();
    this.result = h("div", {});
    this.element = h("details", {}, h("summary", {}, "Or import PSFs from elsewhere"), group("PSFs from elsewhere",
      h("p", {}, "Files that others measured or computed. Of several, give the distance of each, with commas between."),
      field("PSF files", this.files), ...this.form.elements, h("div", { class: "row" }, this.maker), this.job.element, this.result));
  }

  async make() {
    const files = [...(this.files.files ?? [])];
    if (files.length === 0) throw new Error("There is no PSF file yet: choose one or more.");
    this.maker.disabled = true;
    fill(this.result);
    try {
      /** @type {string[]} */
      const psfs = [];
      for (const each of files) psfs.push(await upload(each));
      const job = await this.job.run(KIND, {
        ...this.form.values(), ...this.into(), psfs, distance: this.distance.value.split(",").map((each) => each.trim()),
      });
      if (job) await this.tell(job);
    } finally {
      this.maker.disabled = false;
    }
  }

  /** What was done to each. @param {import("./jobs.js").Job} job */
  async tell({ summary, outputs = [] }) {
    const rows = summary.psfs.flatMap((/** @type {any} */ each) => [
      [each.file, `${each.pixels.join(" × ")} pixels of ${each.pixel}`],
      ["Black level", each.black_stated ? "as stated" : each.background_counts.some(Boolean) ? `${each.background_counts.join(", ")}, from its dark area` : "0"],
      ["Saturated", `${(100 * each.saturated_fraction).toPrecision(2)} %`],
    ]);
    const notes = summary.psfs.flatMap((/** @type {any} */ each) => each.notes).map((/** @type {string} */ note) => h("p", {}, note));
    fill(this.result, h("p", {}, "Saved in ", h("code", {}, await onDisk(folderOf(outputs[0])))), figureTable(rows), ...notes, fileLinks(outputs));
  }
}
