// @ts-check
/** A picture with its exposure, gamma and crop; nothing leaves the browser until it is saved. */

import { fileUrl } from "./api.js";
import { button, fill, group, h, slider, svg } from "./dom.js";
import { baseName } from "./format.js";
import { trouble } from "./notices.js";
import { Viewer } from "./viewer.js";

const LEAST_FRACTION = 0.02;
const WHOLE = { left: 0, top: 0, right: 1, bottom: 1 };

/** Linear light of an sRGB value, both from 0 to 1. @param {number} value */
const linear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
/** @param {number} light */
const encoded = (light) => (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);

/**
 * What each of the 256 values of an sRGB picture becomes.
 *
 * @param {number} stops by which it is brighter, in linear light
 * @param {number} gamma of the tone curve after that; above 1 lifts the shadows
 * @returns {Uint8ClampedArray}
 */
export const toneTable = (stops, gamma) => Uint8ClampedArray.from({ length: 256 }, (_, value) =>
  255 * encoded(Math.min(1, linear(value / 255) * 2 ** stops)) ** (1 / gamma));

/** @param {string} address @returns {Promise<HTMLImageElement>} */
export async function loaded(address) {
  const image = new Image();
  image.src = address;
  try {
    await image.decode();
  } catch {
    throw new Error("The picture cannot be loaded: it may have been moved. Choose it again.");
  }
  return image;
}

/** @typedef {{stops: number, gamma: number, crop: {left: number, top: number, right: number, bottom: number}}} State of the tone and the crop */

/** @type {State} */
const PLAIN = { stops: 0, gamma: 1, crop: WHOLE };

export class Tone {
  constructor() {
    this.canvas = h("canvas", { id: "photograph", width: 480, height: 360, role: "img", "aria-label": "The reconstructed picture" });
    this.shade = svg("path", { class: "shade", "fill-rule": "evenodd" });
    this.overlay = svg("svg", { class: "crop", viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" }, this.shade);
    this.empty = h("p", {}, "Choose a raw file and a PSF, and reconstruct. The picture comes here.");
    this.size = h("span", {});
    this.viewer = new Viewer({ title: "Picture", layers: [this.canvas, this.overlay], over: [this.empty], note: this.size });
    const changed = { change: () => this.keep() };
    this.stops = slider({ label: "Exposure", min: -3, max: 3, value: 0, step: 0.05, ...changed,
      text: (value) => `${value > 0 ? "+" : ""}${value.toFixed(2)} stops`, input: () => this.later() });
    this.gamma = slider({ label: "Gamma", min: 0.4, max: 2.5, value: 1, step: 0.02, ...changed, text: (value) => value.toFixed(2), input: () => this.later() });
    this.crop = { ...WHOLE };
    const edge = (/** @type {string} */ label, /** @type {keyof typeof WHOLE} */ side) => slider({ label, min: 0, max: 1, value: WHOLE[side], ...changed,
      step: 0.005, text: (value) => `${(100 * value).toFixed(1)} %`, input: (value) => this.cut({ ...this.crop, [side]: value }) });
    this.edges = { left: edge("Left edge", "left"), right: edge("Right edge", "right"), top: edge("Upper edge", "top"), bottom: edge("Lower edge", "bottom") };
    this.cropper = button("Crop", () => this.draw(this.viewer.tool === null), { "aria-pressed": "false", disabled: true });
    this.saver = button("Save as PNG", () => this.save(), { class: "primary", disabled: true });
    this.undoer = button("Undo", () => this.step(-1), { disabled: true, "aria-keyshortcuts": "Control+z" });
    this.redoer = button("Redo", () => this.step(1), { disabled: true, "aria-keyshortcuts": "Control+Shift+z" });
    this.others = h("div", {});
    this.controls = group("Tone and crop", h("div", { class: "toning" }, this.stops.element, this.gamma.element,
      h("div", { class: "row" }, this.cropper, this.undoer, this.redoer, button("Reset", () => this.reset()), this.saver)),
    h("details", { class: "edges" }, h("summary", {}, "Edges of the crop"), ...Object.values(this.edges).map(({ element }) => element)), this.others);
    /** @type {ImageData | null} */
    this.original = null;
    this.waiting = false;
    /** @type {State[]} that there were, the one that is shown at `at` */
    this.states = [PLAIN];
    this.at = 0;
  }

  /** Show a file. @param {string} path @param {HTMLElement} [others] links to other forms of it @param {import("./viewer.js").Values} [values] of its pixels */
  async open(path, others, values) {
    const image = await loaded(fileUrl(path));
    await this.show(image, baseName(path), values);
    fill(this.others, others && h("details", {}, h("summary", {}, "Files"), others));
  }

  /** @param {HTMLImageElement} image @param {string} name @param {import("./viewer.js").Values} [values] */
  async show(image, name, values) {
    const { naturalWidth: width, naturalHeight: height } = image;
    const canvas = h("canvas", { width, height });
    const context = canvas.getContext("2d");
    if (!context) return;
    context.drawImage(image, 0, 0);
    this.original = context.getImageData(0, 0, width, height);
    [this.canvas.width, this.canvas.height] = [width, height];
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.empty.hidden = true;
    this.saver.disabled = this.cropper.disabled = false;
    this.states = [PLAIN];
    this.at = 0;
    this.follow();
    this.draw(false);
    this.viewer.renew(name, values);
  }

  /** Say that the picture is of the run before, until another is shown. */
  age() {
    if (this.original) this.viewer.age();
  }

  /** Keep what is shown as one that can be returned to. */
  keep() {
    const state = { stops: this.stops.value(), gamma: this.gamma.value(), crop: this.crop };
    if (JSON.stringify(state) === JSON.stringify(this.states[this.at])) return;
    this.states = [...this.states.slice(0, this.at + 1), state];
    this.at += 1;
    this.offer();
  }

  /** Go back or forth among what was shown. @param {-1 | 1} by @returns {boolean} whether there was one */
  step(by) {
    if (!this.states[this.at + by]) return false;
    this.at += by;
    this.follow();
    return true;
  }

  reset() {
    [this.stops, this.gamma].forEach((each, place) => each.set([PLAIN.stops, PLAIN.gamma][place]));
    this.cut(WHOLE);
    this.redraw();
    this.keep();
  }

  /** Show the state that was chosen. */
  follow() {
    const { stops, gamma, crop } = this.states[this.at];
    this.stops.set(stops);
    this.gamma.set(gamma);
    this.cut(crop);
    this.redraw();
    this.offer();
  }

  offer() {
    this.undoer.disabled = this.at === 0;
    this.redoer.disabled = this.at === this.states.length - 1;
  }

  /** Draw with the next frame, however often a slider moves before. */
  later() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.redraw(); });
  }

  redraw() {
    if (!this.original) return;
    const table = toneTable(this.stops.value(), this.gamma.value());
    const { data, width, height } = this.original;
    const toned = new Uint8ClampedArray(data.length);
    for (let at = 0; at < data.length; at += 4) {
      toned[at] = table[data[at]];
      toned[at + 1] = table[data[at + 1]];
      toned[at + 2] = table[data[at + 2]];
      toned[at + 3] = data[at + 3];
    }
    this.canvas.getContext("2d")?.putImageData(new ImageData(toned, width, height), 0, 0);
  }

  /** @param {typeof WHOLE} asked */
  cut(asked) {
    const within = (/** @type {number} */ value) => Math.min(1, Math.max(0, value));
    const left = Math.min(within(asked.left), 1 - LEAST_FRACTION);
    const top = Math.min(within(asked.top), 1 - LEAST_FRACTION);
    this.crop = { left, top, right: Math.max(within(asked.right), left + LEAST_FRACTION), bottom: Math.max(within(asked.bottom), top + LEAST_FRACTION) };
    for (const [side, each] of Object.entries(this.edges)) each.set(this.crop[/** @type {keyof typeof WHOLE} */ (side)]);
    const { width, height } = this.canvas;
    const box = this.box();
    this.shade.setAttribute("d", `M0 0H${width}V${height}H0ZM${box.x} ${box.y}h${box.width}v${box.height}h${-box.width}Z`);
    this.size.textContent = this.original ? `${box.width} × ${box.height} pixels` : "";
  }

  /** The crop in pixels. */
  box() {
    const { width, height } = this.canvas;
    const [x, y] = [Math.round(this.crop.left * width), Math.round(this.crop.top * height)];
    return { x, y, width: Math.max(1, Math.round(this.crop.right * width) - x), height: Math.max(1, Math.round(this.crop.bottom * height) - y) };
  }

  /** Let the pointer draw a crop on the picture, or not. @param {boolean} on */
  draw(on) {
    this.cropper.setAttribute("aria-pressed", String(on));
    this.viewer.frame.classList.toggle("cropping", on);
    /** @type {[number, number] | null} */
    let from = null;
    const tool = {
      down: (/** @type {[number, number]} */ at) => { from = at; },
      move: (/** @type {[number, number]} */ to) => {
        if (!from) return;
        const [left, right] = [from[0], to[0]].sort((one, other) => one - other);
        const [top, bottom] = [from[1], to[1]].sort((one, other) => one - other);
        this.cut(right - left > LEAST_FRACTION && bottom - top > LEAST_FRACTION ? { left, top, right, bottom } : WHOLE);
      },
      up: () => { from = null; this.keep(); },
    };
    this.viewer.tool = on ? tool : null;
  }

  /** Hand the toned and cropped picture to the visitor. */
  save() {
    const { x, y, width, height } = this.box();
    const canvas = h("canvas", { width, height });
    canvas.getContext("2d")?.drawImage(this.canvas, x, y, width, height, 0, 0, width, height);
    canvas.toBlob((picture) => {
      if (!picture) {
        trouble("The picture is too large for this browser to save; use the file in the workspace.");
        return;
      }
      const link = h("a", { href: URL.createObjectURL(picture), download: `${(this.viewer.title.textContent ?? "picture").replace(/\.[^.]*$/, "")}-edited.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }, "image/png");
  }
}
