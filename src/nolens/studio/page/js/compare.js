// @ts-check
/** Two pictures over one another, with a handle between them: results, and what the sensor measured. */

import { fileUrl } from "./api.js";
import { filesBy, offerFiles } from "./choices.js";
import { field, h } from "./dom.js";
import { baseName } from "./format.js";
import { run } from "./jobs.js";
import { told } from "./notices.js";
import { Viewer } from "./viewer.js";

/** Sides of pictures that differ by less show the same view in other pixels. */
const SAME_VIEW = 0.03;
const SHOWN = /\.(png|jpe?g)$/i;
const KEY_STEP = 0.02;
const MEASURED = "measured:";

export class Compare {
  constructor() {
    this.one = h("select", { onchange: told(() => this.show()) });
    this.other = h("select", { onchange: told(() => this.show()) });
    this.left = h("img", { alt: "" });
    this.right = h("img", { alt: "", onload: () => this.fit() });
    this.handle = h("div", { class: "divide", role: "slider", tabIndex: 0, "aria-label": "Left picture up to", "aria-valuemin": 0, "aria-valuemax": 100 });
    this.empty = h("p", {}, "Reconstruct once, and compare the measurement with the picture; or twice, and compare two results.");
    this.viewer = new Viewer({ title: "Comparison", layers: [this.left, this.right], over: [this.handle, this.empty], moved: () => this.divide() });
    this.left.addEventListener("load", () => this.fit());
    this.element = h("div", { class: "stage", hidden: true }, this.viewer.element,
      h("div", { class: "pair" }, field("Left", this.one), field("Right", this.other)));
    /** Where the handle stands, as a fraction of the frame. */
    this.at = 0.5;
    /** @type {Map<string, Promise<string>>} previews of measurements, by path */
    this.previews = new Map();
    this.drag();
    this.divide();
  }

  /** The handle follows pointer and keys. */
  drag() {
    const { handle } = this;
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      event.preventDefault();
      handle.focus();
    });
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const box = this.viewer.frame.getBoundingClientRect();
      this.put((event.clientX - box.left) / box.width);
    });
    handle.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -KEY_STEP, ArrowDown: -KEY_STEP, ArrowRight: KEY_STEP, ArrowUp: KEY_STEP, Home: -1, End: 1 }[event.key];
      if (by === undefined) return;
      event.preventDefault();
      this.put(this.at + by);
    });
  }

  /** @param {number} at */
  put(at) {
    this.at = Math.min(1, Math.max(0, at));
    this.divide();
  }

  /**
   * Offer the pictures there are.
   *
   * @param {string} [made] the newest one
   * @param {string} [measured] path of what it was reconstructed from: compared with it, unless another picture was there
   */
  async refresh(made, measured) {
    const groups = await filesBy((entry) => SHOWN.test(entry.name));
    if (measured) this.measured = measured;
    const raw = this.measured ? [{ value: `${MEASURED}${this.measured}`, label: `${baseName(this.measured)} (measurement)` }] : [];
    for (const select of [this.one, this.other]) offerFiles(select, groups, "Choose a picture", raw);
    const results = groups.find(({ place }) => place.endsWith("/pictures"))?.files ?? [];
    if (made && this.other.value !== made) {
      if (this.other.value && !this.other.value.startsWith(MEASURED)) this.one.value = this.other.value;
      this.other.value = made;
    }
    if (!this.other.value && results[0]) this.other.value = results[0].path;
    if (!this.one.value) this.one.value = raw[0]?.value ?? results[1]?.path ?? "";
    await this.show();
  }

  /** Address of what was chosen. @param {string} chosen */
  async address(chosen) {
    if (!chosen.startsWith(MEASURED)) return fileUrl(chosen);
    const path = chosen.slice(MEASURED.length);
    if (!this.previews.has(path)) {
      const preview = run("preview", { path }).then(({ outputs }) => fileUrl(outputs?.[0] ?? ""));
      this.previews.set(path, preview);
      preview.catch(() => this.previews.delete(path));
    }
    return /** @type {Promise<string>} */ (this.previews.get(path));
  }

  async show() {
    for (const [select, image] of /** @type {[HTMLSelectElement, HTMLImageElement][]} */ ([[this.one, this.left], [this.other, this.right]])) {
      const chosen = select.value;
      const address = chosen && await this.address(chosen);
      if (select.value !== chosen) return;
      image.hidden = !address;
      if (address && image.getAttribute("src") !== address) image.src = address;
      image.alt = baseName(chosen);
    }
    this.empty.hidden = !(this.left.hidden && this.right.hidden);
    this.fit();
  }

  /** Lay pictures of the same view over one another, though larger pixels cover it less exactly. */
  fit() {
    const [left, right] = [this.left, this.right].map((each) => each.naturalWidth / each.naturalHeight);
    const alike = Math.abs(left / right - 1) < SAME_VIEW;
    for (const each of [this.left, this.right]) each.style.objectFit = alike ? "fill" : "";
    const finer = this.left.hidden || this.right.naturalWidth > this.left.naturalWidth ? this.right : this.left;
    this.viewer.base = finer;
    this.viewer.lay();
  }

  /** Cut both pictures where the handle is, wherever the picture has been moved. */
  divide() {
    const { viewer, at } = this;
    const box = viewer.frame.getBoundingClientRect();
    const [across] = viewer.place(box.left + at * box.width, box.top);
    const part = this.left.hidden ? 0 : this.right.hidden ? 1 : Math.min(1, Math.max(0, across || 0));
    this.right.style.clipPath = `inset(0 0 0 ${100 * part}%)`;
    this.left.style.clipPath = `inset(0 ${100 * (1 - part)}% 0 0)`;
    this.handle.style.left = `${100 * at}%`;
    this.handle.setAttribute("aria-valuenow", (100 * at).toFixed(0));
    this.handle.hidden = this.left.hidden || this.right.hidden;
  }
}
