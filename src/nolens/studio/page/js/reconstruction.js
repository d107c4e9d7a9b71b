// @ts-check
/** How a raw file is read and reconstructed: the options that a person may leave as they are. */

import { offerFiles } from "./choices.js";
import { field, h, segments, slider, tick } from "./dom.js";
import { folderOf, number } from "./format.js";
import { label, option } from "./names.js";
import { told } from "./notices.js";

const KIND = "reconstruct";
const TAU = 1e-4;
const TURNS = [["none", "As it is"], ["vertical", "Upside down"], ["horizontal", "Mirrored"], ["both", "Rotated by 180°"]];
const MOSAICS = ["RGGB", "BGGR", "GRBG", "GBRG"];

/** @param {string} placeholder */
const typed = (placeholder) => h("input", { type: "text", placeholder, spellcheck: false });
/** @param {string} placeholder @param {number} most */
const counted = (placeholder, most) => h("input", { type: "number", min: 1, max: most, placeholder });
/** @param {string[][]} choices */
const chosen = (choices) => h("select", {}, ...choices.map(([value, label]) => h("option", { value }, label)));

/** @param {HTMLInputElement} input */
const text = (input) => input.value.trim() || undefined;
/** A number where it is one; else the text, which the studio then says more about. @param {HTMLInputElement} input */
const value = (input) => {
  const said = text(input);
  return said === undefined || Number.isNaN(Number(said)) ? said : Number(said);
};

export class ReconstructionOptions {
  /** @param {(input: HTMLInputElement, select: HTMLSelectElement) => Promise<void>} bring stores a file of the visitor's and chooses it */
  constructor(bring) {
    this.quality = segments(label(KIND, "quality"), [["draft", "Draft"], ["photo", "Photo"], ["exact", "Exact"]], "photo", () => {});
    this.dark = h("select", {});
    this.darkFile = h("input", { type: "file", onchange: told(() => bring(this.darkFile, this.dark)) });
    this.black = typed("as the file says; a number, or auto");
    this.white = typed("as the file says");
    this.mosaic = chosen([["", "As the file says"], ...MOSAICS.map((each) => [each, each])]);
    this.bgr = tick(label(KIND, "bgr"), false);
    this.wider = tick(label(KIND, "psf_extent"), false);
    this.scale = counted("1", 64);
    this.region = typed("rows x columns, such as 400x400");
    this.angle = typed("such as 40deg");
    this.bin = counted("by the PSF", 64);
    this.channels = typed("all; grey, or letters such as rg");
    this.flip = chosen(TURNS);
    this.ownTau = tick("Choose τ", false, (on) => { this.tau.element.hidden = !on; });
    this.tau = slider({ label: label(KIND, "tau"), min: 1e-6, max: 1e-1, value: TAU, log: true, text: (tau) => number(tau, 2) });
    this.tau.element.hidden = true;
    this.iterations = counted("by quality", 100000);
    const more = (/** @type {string} */ title, /** @type {HTMLElement[]} */ ...fields) =>
      h("details", {}, h("summary", {}, title), h("div", { class: "fields" }, ...fields));
    this.elements = [
      this.quality.element,
      more("The files", option(KIND, "dark", this.dark), field("Or a dark frame of yours", this.darkFile), option(KIND, "black", this.black), option(KIND, "white", this.white),
        option(KIND, "mosaic", this.mosaic), this.bgr.element,
        h("p", { class: "pale" }, "A PSF file that is larger than the raw file is either:"),
        this.wider.element, option(KIND, "psf_scale", this.scale)),
      more("The scene", h("p", { class: "pale" }, "The support: where light can come from. Leave both empty for no limit."),
        option(KIND, "support", this.region), option(KIND, "field", this.angle),
        option(KIND, "bin", this.bin), option(KIND, "channels", this.channels), option(KIND, "flip", this.flip)),
      more("The solver", this.ownTau.element, this.tau.element, option(KIND, "iterations", this.iterations)),
    ];
  }

  /** Dark frames to choose from. @param {import("./choices.js").Group[]} files */
  offer(files) {
    offerFiles(this.dark, files, "None");
  }

  /** How the raw file is read, and what of the scene is reconstructed. */
  reading() {
    return {
      dark: this.dark.value, black: value(this.black), white: value(this.white), mosaic: this.mosaic.value,
      bgr: this.bgr.box.checked || undefined, bin: value(this.bin), channels: text(this.channels),
      support: text(this.region), flip: this.flip.value === "none" ? undefined : this.flip.value,
    };
  }

  /** All of a reconstruction. @param {string} psf path of its PSF, whose camera turns angles into pixels */
  all(psf) {
    const angle = text(this.angle);
    return {
      ...this.reading(), quality: this.quality.value(), psf_extent: this.wider.box.checked ? "wide" : undefined, psf_scale: value(this.scale),
      tau: this.ownTau.box.checked ? this.tau.value() : undefined, iterations: value(this.iterations),
      field: angle, camera: angle && folderOf(psf),
    };
  }
}
