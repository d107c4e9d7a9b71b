// @ts-check
/** A picture with its exposure, gamma and crop; nothing leaves the browser until it is saved. */

import { fileUrl } from "./api.js";
import { button, fill, group, h, slider, svg } from "./dom.js";
import { baseName } from "./format.js";
import { trouble } from "./notices.js";

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

export class Tone {
  constructor() {
    this.canvas = h("canvas", { id: "photograph", width: 480, height: 360, role: "img", "aria-label": "The reconstructed picture" });
    this.shade = svg("path", { class: "shade", "fill-rule": "evenodd" });
    this.overlay = svg("svg", { class: "crop", viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" }, this.shade);
    this.empty = h("p", {}, "Choose a raw file and a PSF, and reconstruct. The picture comes here.");
    this.frame = h("div", { class: "frame" }, this.canvas, this.overlay, this.empty);
    this.name = h("b", {}, "Picture");
    this.size = h("span", {});
    this.stops = slider({ label: "Exposure", min: -3, max: 3, value: 0, step: 0.05,
      text: (value) => `${value > 0 ? "+" : ""}${value.toFixed(2)} stops`, input: () => this.later() });
    this.gamma = slider({ label: "Gamma", min: 0.4, max: 2.5, value: 1, step: 0.02, text: (value) => value.toFixed(2), input: () => this.later() });
    this.crop = { ...WHOLE };
    const edge = (/** @type {string} */ label, /** @type {keyof typeof WHOLE} */ side) => slider({ label, min: 0, max: 1, value: WHOLE[side],
      step: 0.005, text: (value) => `${(100 * value).toFixed(1)} %`, input: (value) => this.cut({ ...this.crop, [side]: value }) });
    this.edges = { left: edge("Left edge", "left"), right: edge("Right edge", "right"), top: edge("Upper edge", "top"), bottom: edge("Lower edge", "bottom") };
    this.saver = button("Save as PNG", () => this.save(), { class: "primary", disabled: true });
    this.others = h("div", {});
    this.view = h("figure", { class: "view" }, this.frame, h("figcaption", {}, this.name, this.size));
    this.controls = group("Tone and crop", h("div", { class: "three" },
      h("div", {}, this.stops.element, this.gamma.element),
      h("details", { class: "edges" }, h("summary", {}, "Crop: draw on the picture, or set the edges"),
        ...Object.values(this.edges).map(({ element }) => element)),
      h("div", {}, h("div", { class: "row" }, this.saver, button("Reset", () => this.reset())), this.others)));
    /** @type {ImageData | null} */
    this.original = null;
    this.waiting = false;
    this.drag();
  }

  /** Show a file. @param {string} path @param {HTMLElement} [others] links to other forms of it */
  async open(path, others) {
    const image = await loaded(fileUrl(path));
    await this.show(image, baseName(path));
    fill(this.others, others);
  }

  /** @param {HTMLImageElement} image @param {string} name */
  async show(image, name) {
    const { naturalWidth: width, naturalHeight: height } = image;
    const canvas = h("canvas", { width, height });
    const context = canvas.getContext("2d");
    if (!context) return;
    context.drawImage(image, 0, 0);
    this.original = context.getImageData(0, 0, width, height);
    [this.canvas.width, this.canvas.height] = [width, height];
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.overlay.setAttribute("preserveAspectRatio", "xMidYMid meet");
    this.name.textContent = name;
    this.view.classList.remove("previous");
    this.empty.hidden = true;
    this.saver.disabled = false;
    fill(this.others);
    this.reset();
  }

  /** Say that the picture is of the run before, until another is shown. */
  age() {
    if (!this.original || this.view.classList.contains("previous")) return;
    this.view.classList.add("previous");
    this.name.textContent = `Previous picture: ${this.name.textContent}`;
  }

  reset() {
    this.stops.set(0);
    this.gamma.set(1);
    this.cut({ ...WHOLE });
    this.redraw();
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

  /** Draw a crop on the picture with the pointer; a click takes it away. */
  drag() {
    /** @type {[number, number] | null} */
    let from = null;
    const place = (/** @type {PointerEvent} */ event) => {
      const outer = this.canvas.getBoundingClientRect();
      const scale = Math.min(outer.width / this.canvas.width, outer.height / this.canvas.height);
      const inner = [this.canvas.width * scale, this.canvas.height * scale];
      return /** @type {[number, number]} */ ([
        (event.clientX - outer.left - (outer.width - inner[0]) / 2) / inner[0],
        (event.clientY - outer.top - (outer.height - inner[1]) / 2) / inner[1]]);
    };
    const onto = (/** @type {PointerEvent} */ event) => {
      if (!from) return;
      const to = place(event);
      const [left, right] = [from[0], to[0]].sort((one, other) => one - other);
      const [top, bottom] = [from[1], to[1]].sort((one, other) => one - other);
      this.cut(right - left > LEAST_FRACTION && bottom - top > LEAST_FRACTION ? { left, top, right, bottom } : { ...WHOLE });
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      if (!this.original) return;
      from = place(event);
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", onto);
    this.canvas.addEventListener("pointerup", (event) => { onto(event); from = null; });
    this.canvas.addEventListener("pointercancel", () => { from = null; });
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
      const link = h("a", { href: URL.createObjectURL(picture), download: `${(this.name.textContent ?? "picture").replace(/\.[^.]*$/, "")}-edited.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }, "image/png");
  }
}
