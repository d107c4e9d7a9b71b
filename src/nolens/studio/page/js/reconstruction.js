// @ts-check
/** How a raw file is read and reconstructed: the options that a person may leave as they are. */

import { offerFiles, offerFilesToo } from "./choices.js";
import { control, detailSlider, form } from "./controls.js";
import { filePicker, h, segments } from "./dom.js";
import { folderOf } from "./format.js";
import { label, option } from "./names.js";
import { told } from "./notices.js";

const KIND = "reconstruct";
const FILE_SAYS = "as the file says";
/** @type {Record<string, import("./controls.js").Words>} what the page adds to the declarations */
export const MORE = {
  black: { example: `${FILE_SAYS}; a number, or auto` },
  white: { example: FILE_SAYS },
  mosaic: { words: Object.fromEntries([["", "As the file says"], ...["RGGB", "BGGR", "GRBG", "GBRG"].map((each) => [each, each])]) },
  psf_extent: { words: { auto: "What explains the measurement", sensor: "As large as the sensor, on finer pixels", wide: "Extended: with the light beside the sensor" } },
  psf_scale: { example: "automatic; such as 2" },
  psf_flip: { words: { auto: "What explains the measurement", none: "As it is", vertical: "Upside down", horizontal: "Mirrored", both: "Rotated by 180°" } },
  distance: { example: "such as 300mm" },
  field_points: { example: "all there are; such as 9" },
  depths: { example: "one; such as 8cm,20cm,inf" },
  bands: { example: "the sensor's colours; such as 12" },
  spectrum_at: { example: "such as 120,200" },
  uncertainty: { example: "none; such as 8" },
  frames: { example: "a picture; such as 24" },
  exposure: { example: "as the file says; such as 1ms" },
  support: { example: "auto, full or such as 400x400" },
  field: { example: "such as 40deg" },
  channels: { example: "all; grey, or letters such as rg" },
  bin: { example: "by the PSF" },
  crop: { example: "the support; such as 400x400+20+0" },
  flip: { words: { none: "As it is", vertical: "Upside down", horizontal: "Mirrored", both: "Rotated by 180°" } },
  prior: { words: { auto: "Automatic (a photo: trained network)", "colour-tv": "Total variation of the colours together", tv: "Total variation", "isotropic-tv": "Isotropic total variation", l1: "Few bright points (l1)", none: "No negative light, nothing else", ridge: "Trained filters (ridge)", denoiser: "Trained network (denoiser)", unrolled: "Trained network, then another that mends its picture (unrolled)" } },
  noise: { words: { auto: "Of depths: by the sensor, where it is known", even: "As much everywhere", shot: "More where there is more light", poisson: "Poisson's law" } },
  iterations: { example: "by quality" },
  tau: { example: "automatic" },
  sweep: { words: { "": "One picture", tau: "With more and less detail", method: "Solvers", prior: "Priors", support: "Supports" } },
};
/** Options of how the raw file is read: those that refocusing has too. */
export const READING = ["black", "white", "mosaic", "bgr", "bin", "channels", "support", "flip"];
const STACKS = ["depths", "bands", "spectrum_at", "frames", "exposure"];
const RECTIFIED = ["flatten", "undistort"];
const SOLVING = ["sweep", "uncertainty", ...STACKS, ...RECTIFIED, "distance", "psf_extent", "psf_scale", "psf_flip", "crop", "tau", "method", "field_points", "prior", "noise", "depth_smoothness", "spectral_smoothness", "iterations", "tolerance", "low_frequency"];

export class ReconstructionOptions {
  /** @param {(file: File, select: HTMLSelectElement, accepted?: string) => Promise<void>} bring stores a file of the visitor's and chooses it */
  constructor(bring) {
    this.quality = segments(label(KIND, "quality"), [["draft", "Draft"], ["photo", "Photo"], ["exact", "Exact"]], "photo", () => {});
    this.files = { dark: h("select", {}), flat: h("select", {}) };
    this.controls = Object.fromEntries([...READING, ...SOLVING, "field"].map((name) => [name, control(KIND, name, MORE[name])]));
    this.detail = detailSlider();
    const { controls, files } = this;
    /** @type {Record<string, HTMLElement[]>} */
    const fields = { detail: [this.detail.element] };
    const row = (/** @type {string} */ name, /** @type {HTMLElement} */ element, /** @type {HTMLSelectElement} */ select, /** @type {string | undefined} */ accepted = undefined) =>
      h("div", { class: "row low" }, h("div", { class: "grow" }, element),
        filePicker("Bring…", told(([file]) => bring(file, select, accepted)), { "aria-label": `${label(KIND, name)} of yours` }));
    for (const [name, select] of Object.entries(files)) fields[name] = [row(name, option(KIND, name, select), select)];
    for (const [name, { element }] of Object.entries(controls)) fields[name] = [element];
    const { element, select } = controls.prior;
    if (select) fields.prior = [row("prior", element, select, "an .npz of weights that nolens train wrote")];
    this.elements = form(KIND, fields);
  }

  /** Dark frames, flat fields and weights to choose from. @param {Record<"darks" | "weights", import("./choices.js").Group[]>} files */
  offer({ darks, weights }) {
    for (const select of Object.values(this.files)) offerFiles(select, darks, "None");
    const { select } = this.controls.prior;
    if (select) offerFilesToo(select, weights);
  }

  /** @param {string[]} names */
  values(names) {
    return Object.fromEntries(names.map((name) => [name, this.controls[name].value()]));
  }

  /** Settings of an earlier reconstruction; what was left out then is left out again. @param {Record<string, any>} settings by option */
  use(settings) {
    for (const [name, each] of Object.entries(this.controls)) each.set(settings[name]);
    for (const [name, select] of Object.entries(this.files)) select.value = settings[name] ?? "";
    this.quality.set(settings.quality ?? "photo");
    this.detail.set(settings.detail ?? 1);
  }

  /** How the raw file is read, and what of the scene is reconstructed. */
  reading() {
    return { dark: this.files.dark.value, flat: this.files.flat.value, ...this.values(READING) };
  }

  /**
   * All of a reconstruction.
   *
   * @param {string} psf path of its PSF, whose camera turns angles into pixels
   * @param {string[]} cameras folders of calibrated cameras: depths and bands take all PSFs of one
   */
  all(psf, cameras) {
    const [angle, detail, quality] = [this.controls.field.value(), this.detail.value(), this.quality.value()];
    const needed = angle || RECTIFIED.some((name) => this.controls[name].value());
    const whole = (this.controls.depths.value() || this.controls.bands.value()) && cameras.includes(folderOf(psf));
    return {
      ...(whole ? { psf: `${folderOf(psf)}/psfs.toml` } : {}), ...this.reading(), ...this.values(SOLVING), quality: quality === "photo" ? undefined : quality,
      detail: detail === 1 ? undefined : detail, field: angle, camera: needed ? folderOf(psf) : undefined,
    };
  }
}
