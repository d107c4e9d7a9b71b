// @ts-check
/** A focal stack: a slider for the depth, and a click on what is to be sharp. */

import { fileUrl } from "./api.js";
import { button, h, slider } from "./dom.js";
import { Viewer } from "./viewer.js";

/** @typedef {{depths: string[], pages: string[], everywhere: string, best_page: number[][]}} FocalStack */

/**
 * What the page of `nolens refocus --stack` holds: its pictures, and the number of the sharpest at each place.
 *
 * @param {string} html
 * @returns {FocalStack}
 */
export function stackOf(html) {
  // Pages of the version before say "told" and "sharpest".
  const match = /\nconst (?:stack|told) = (.*);\n/.exec(html);
  if (!match) throw new Error("The focal stack cannot be read: make it again.");
  const { sharpest, ...stack } = JSON.parse(match[1]);
  return { best_page: sharpest, ...stack };
}

export class Depths {
  constructor() {
    /** @type {FocalStack | null} */
    this.stack = null;
    this.picture = h("img", { id: "depth-picture", alt: "", hidden: true });
    this.mark = h("span", { class: "focus-mark", hidden: true });
    this.empty = h("p", {}, "Make a focal stack of a raw file: then click on what is to be sharp.");
    this.depth = slider({ label: "Depth", min: 0, max: 1, value: 0, step: 1,
      text: (page) => this.stack?.depths[page] ?? "–", input: (page) => { this.mark.hidden = true; this.show(page); } });
    this.all = button("Sharp everywhere", () => this.everywhere(), { "aria-pressed": "true", disabled: true });
    this.said = h("span", { role: "status" });
    this.depth.input.disabled = true;
    this.viewer = new Viewer({ title: "Focal stack", layers: [this.picture, this.mark], over: [this.empty], note: this.said });
    this.viewer.frame.addEventListener("click", (event) => this.click(event));
    this.element = h("div", { class: "stage", hidden: true },
      this.viewer.element,
      this.depth.element, h("div", { class: "row" }, this.all, h("small", {}, "Click on the picture to focus there.")));
  }

  /** Show the stack that a job made. @param {string[]} outputs */
  async open(outputs) {
    const page = outputs.find((path) => path.endsWith("sweep.html"));
    if (!page) throw new Error("The job wrote no focal stack.");
    const answer = await fetch(fileUrl(page));
    if (!answer.ok) throw new Error("The focal stack no longer exists: make it again.");
    this.stack = stackOf(await answer.text());
    this.depth.limit(0, this.stack.pages.length - 1);
    this.depth.input.disabled = this.all.disabled = false;
    this.empty.hidden = true;
    this.picture.hidden = false;
    this.viewer.renew("Focal stack");
    this.everywhere();
  }

  /** Say that the stack is of the run before, until the next one is open. */
  age() {
    if (this.stack) this.viewer.age();
  }

  /** @param {number} page */
  show(page) {
    if (!this.stack) return;
    this.picture.src = this.stack.pages[page];
    this.picture.alt = `The scene, sharp at ${this.stack.depths[page]}`;
    this.depth.set(page);
    this.said.textContent = `Sharp at ${this.stack.depths[page]}`;
    this.all.setAttribute("aria-pressed", "false");
  }

  everywhere() {
    if (!this.stack) return;
    this.picture.src = this.stack.everywhere;
    this.picture.alt = "The scene, sharp everywhere";
    this.mark.hidden = true;
    this.said.textContent = "Sharp everywhere";
    this.all.setAttribute("aria-pressed", "true");
  }

  /** @param {MouseEvent} event */
  click(event) {
    if (!this.stack) return;
    const [across, down] = this.viewer.place(event.clientX, event.clientY);
    if (across < 0 || across >= 1 || down < 0 || down >= 1) return;
    const grid = this.stack.best_page;
    this.show(grid[Math.floor(down * grid.length)][Math.floor(across * grid[0].length)]);
    this.mark.style.left = `${100 * across}%`;
    this.mark.style.top = `${100 * down}%`;
    this.mark.hidden = false;
  }
}
