// @ts-check
/** Two pictures over one another, with a slider between them. */

import { fileUrl } from "./api.js";
import { filesBy, offerFiles } from "./choices.js";
import { field, h, slider } from "./dom.js";
import { baseName } from "./format.js";

/** Sides of pictures that differ by less show the same view in other cells. */
const SAME_VIEW = 0.03;
const SHOWN = /\.(png|jpe?g)$/i;

export class Compare {
  constructor() {
    this.one = h("select", { onchange: () => this.show() });
    this.other = h("select", { onchange: () => this.show() });
    this.left = h("img", { alt: "", onload: () => this.fit() });
    this.right = h("img", { alt: "", onload: () => this.fit() });
    this.line = h("div", { class: "divide", "aria-hidden": "true" });
    this.empty = h("p", {}, "Reconstruct twice, with different methods or depths, and compare the two here.");
    this.frame = h("div", { class: "frame" }, this.left, this.right, this.line, this.empty);
    this.share = slider({ label: "Left picture up to", min: 0, max: 100, value: 50, step: 0.5,
      text: (value) => `${value.toFixed(0)} %`, input: () => this.divide() });
    this.element = h("div", { class: "stage", hidden: true },
      h("figure", { class: "view" }, this.frame), this.share.element,
      h("div", { class: "pair" }, field("Left", this.one), field("Right", this.other)));
    this.frame.addEventListener("pointermove", (event) => {
      if (event.buttons === 0 && event.pointerType === "mouse") return;
      const box = this.frame.getBoundingClientRect();
      this.share.set((100 * (event.clientX - box.left)) / box.width);
      this.divide();
    });
    this.divide();
  }

  /** Offer the pictures there are. @param {string} [made] the newest one, to be compared with the one before it */
  async refresh(made) {
    const groups = await filesBy((entry) => SHOWN.test(entry.name));
    for (const select of [this.one, this.other]) offerFiles(select, groups, "Choose a picture");
    const known = groups.find(({ place }) => place.endsWith("/pictures"))?.files ?? [];
    if (made && this.other.value !== made) {
      if (this.other.value) this.one.value = this.other.value;
      this.other.value = made;
    }
    if (!this.other.value && known[0]) this.other.value = known[0].path;
    if (!this.one.value && known[1]) this.one.value = known[1].path;
    this.show();
  }

  show() {
    for (const [select, image] of /** @type {[HTMLSelectElement, HTMLImageElement][]} */ ([[this.one, this.left], [this.other, this.right]])) {
      image.hidden = select.value === "";
      if (image.hidden) continue;
      if (image.getAttribute("src") !== fileUrl(select.value)) image.src = fileUrl(select.value);
      image.alt = baseName(select.value);
    }
    this.empty.hidden = !(this.left.hidden && this.right.hidden);
    this.divide();
  }

  /** Lay pictures of the same view over one another, though larger cells cover it less exactly. */
  fit() {
    const [left, right] = [this.left, this.right].map((each) => each.naturalWidth / each.naturalHeight);
    const alike = Math.abs(left / right - 1) < SAME_VIEW;
    for (const each of [this.left, this.right]) each.style.objectFit = alike ? "fill" : "";
    this.frame.style.aspectRatio = alike ? String(left) : "";
  }

  divide() {
    const share = this.left.hidden ? 0 : this.right.hidden ? 100 : this.share.value();
    this.right.style.clipPath = `inset(0 0 0 ${share}%)`;
    this.left.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    this.line.style.left = `${share}%`;
    this.line.hidden = this.left.hidden || this.right.hidden;
  }
}
