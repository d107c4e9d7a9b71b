// @ts-check
/** The one way in which pictures are looked at: zoom, full screen, and the values under the pointer. */

import { fill, h, svg } from "./dom.js";
import { number } from "./format.js";

const STEP = 1.5;
/** Screen pixels along a pixel of the picture, at most. */
const LARGEST = 48;
/** From this size on, pixels are shown as squares. */
const SQUARES = 3;
const ARROWS = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });

/** @typedef {{at: (across: number, down: number) => string}} Values what a place holds, as text */
/** @typedef {{down: (at: [number, number]) => void, move: (at: [number, number]) => void, up: () => void}} Tool draws on the picture */

export class Viewer {
  /**
   * @param {object} given
   * @param {string} given.title
   * @param {Element[]} given.layers canvas, pictures and drawings, one over the other; the first has the picture's size
   * @param {HTMLElement[]} [given.over] what stays in its place when the picture moves
   * @param {HTMLElement} [given.note] beside the title
   * @param {() => void} [given.moved] is called when the picture has been laid out anew
   */
  constructor({ title, layers, over = [], note, moved = () => {} }) {
    this.moved = moved;
    this.base = /** @type {HTMLCanvasElement | HTMLImageElement | HTMLVideoElement} */ (layers[0]);
    this.plane = h("div", { class: "plane" }, layers);
    this.frame = h("div", { class: "frame", tabIndex: 0, role: "group", "aria-label": `${title}: + and − zoom, arrows move, 0 fits, f fills the screen` }, this.plane, over);
    this.title = h("b", {}, title);
    this.note = note ?? h("span", {});
    this.probe = h("output", { class: "probe", "aria-live": "off" });
    this.size = h("output", { class: "scale" });
    const corners = svg("svg", { viewBox: "0 0 16 16", width: 14, height: 14, "aria-hidden": "true" },
      svg("path", { d: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4", fill: "none", stroke: "currentColor", "stroke-width": 2 }));
    const tool = (/** @type {string | Element} */ text, /** @type {string} */ name, /** @type {() => void} */ clicked) =>
      h("button", { type: "button", onclick: clicked, class: "tool", title: name, "aria-label": `${name}: ${title}` }, text);
    this.tools = h("div", { class: "zoom" }, tool("−", "Smaller", () => this.zoom(1 / STEP)), this.size, tool("+", "Larger", () => this.zoom(STEP)),
      tool("Fit", "Whole picture", () => this.fit()), tool("1:1", "Pixel for pixel", () => this.whole()), tool(corners, "Full screen", () => this.fill()));
    this.element = h("figure", { class: "view" }, this.frame,
      h("figcaption", {}, h("span", { class: "named" }, this.title, " ", this.note), this.tools), this.probe);
    /** @type {number | null} screen pixels along a pixel of the picture; null where the whole picture is seen */
    this.scale = null;
    /** Place of the picture that is in the middle, as fractions. */
    this.middle = [0.5, 0.5];
    /** @type {Values | null} */
    this.values = null;
    /** @type {Tool | null} */
    this.tool = null;
    /** @type {[number, number] | null} */
    this.probed = null;
    new ResizeObserver(() => this.lay()).observe(this.frame);
    this.base.addEventListener("load", () => this.lay());
    this.listen();
  }

  /** Width and height of the picture in its own pixels. @returns {[number, number]} */
  get pixels() {
    const { base } = this;
    return base instanceof HTMLImageElement ? [base.naturalWidth || 1, base.naturalHeight || 1] : [base.width, base.height];
  }

  /** Scale at which the whole picture is seen. */
  get fitting() {
    const [width, height] = this.pixels;
    return Math.min(this.frame.clientWidth / width, this.frame.clientHeight / height) || 1;
  }

  /** Put the picture where it is to be. */
  lay() {
    const [width, height] = this.pixels;
    const scale = this.scale ?? this.fitting;
    const room = [this.frame.clientWidth, this.frame.clientHeight];
    const places = [width, height].map((count, axis) => {
      const [side, half] = [count * scale, room[axis] / 2];
      if (side <= room[axis]) this.middle[axis] = 0.5;
      else this.middle[axis] = Math.min(1 - half / side, Math.max(half / side, this.middle[axis]));
      return [half - this.middle[axis] * side, side];
    });
    Object.assign(this.plane.style, { left: `${places[0][0]}px`, top: `${places[1][0]}px`, width: `${places[0][1]}px`, height: `${places[1][1]}px` });
    this.plane.classList.toggle("squares", scale * devicePixelRatio >= SQUARES);
    this.frame.classList.toggle("zoomed", scale > this.fitting);
    this.size.textContent = `${number(100 * scale * devicePixelRatio, 2)} %`;
    this.moved();
  }

  /** Another scale, about a place of the screen. @param {number} factor @param {[number, number]} [about] */
  zoom(factor, about) {
    this.rescale((this.scale ?? this.fitting) * factor, about);
  }

  /** @param {number} scale @param {[number, number]} [about] */
  rescale(scale, about) {
    const box = this.frame.getBoundingClientRect();
    const [x, y] = about ?? [box.left + box.width / 2, box.top + box.height / 2];
    const held = this.place(x, y);
    this.scale = Math.min(LARGEST, Math.max(Math.min(this.fitting, 1 / devicePixelRatio), scale));
    const from = [x - box.left - box.width / 2, y - box.top - box.height / 2];
    this.middle = this.pixels.map((count, axis) => held[axis] - from[axis] / (count * /** @type {number} */ (this.scale)));
    this.lay();
  }

  fit() {
    this.scale = null;
    this.lay();
  }

  /** A pixel of the picture on each pixel of the screen. */
  whole() {
    this.rescale(1 / devicePixelRatio);
  }

  /** Fill the screen, or leave it. Where a browser lends none, as on some phones, the window. */
  async fill() {
    if (document.fullscreenElement === this.element) await document.exitFullscreen();
    else if (this.element.requestFullscreen) await this.element.requestFullscreen();
    else this.element.classList.toggle("full");
    this.lay();
  }

  /** Place of the picture under a place of the screen, as fractions of its width and height. @param {number} x @param {number} y @returns {[number, number]} */
  place(x, y) {
    const box = this.plane.getBoundingClientRect();
    return [(x - box.left) / box.width, (y - box.top) / box.height];
  }

  /** Say what is under a place of the screen. @param {[number, number] | null} at */
  read(at) {
    this.probed = at;
    if (at === null) return;
    const [across, down] = this.place(...at);
    const inside = across >= 0 && across < 1 && down >= 0 && down < 1;
    const [width, height] = this.pixels;
    this.probe.textContent = !inside || this.base.hidden ? ""
      : this.values ? this.values.at(across, down) : `x ${Math.floor(across * width)}, y ${Math.floor(down * height)}`;
  }

  /** Say again what is under the pointer, when the values have come. */
  again() {
    if (this.frame.checkVisibility()) this.read(this.probed);
  }

  listen() {
    /** @type {Map<number, [number, number]>} */
    const held = new Map();
    let distance = 0;
    const { frame } = this;
    const apart = () => {
      const [one, other] = [...held.values()];
      return Math.hypot(one[0] - other[0], one[1] - other[1]);
    };
    frame.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || /** @type {Element} */ (event.target).closest("button, video, [role=slider]")) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      this.read([event.clientX, event.clientY]);
      if (this.tool && held.size === 1) this.tool.down(this.place(event.clientX, event.clientY));
      if (held.size === 2) distance = apart();
      if (this.tool || this.scale !== null || held.size === 2) frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      this.read([event.clientX, event.clientY]);
      const before = held.get(event.pointerId);
      if (!before) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 2) {
        const [one, other] = [...held.values()];
        this.zoom(apart() / distance, [(one[0] + other[0]) / 2, (one[1] + other[1]) / 2]);
        distance = apart();
      } else if (this.tool) {
        this.tool.move(this.place(event.clientX, event.clientY));
      } else if (this.scale !== null) {
        this.shift(before[0] - event.clientX, before[1] - event.clientY);
      }
    });
    const release = (/** @type {PointerEvent} */ event) => {
      if (held.delete(event.pointerId) && held.size === 0) this.tool?.up();
    };
    for (const name of ["pointerup", "pointercancel"]) frame.addEventListener(name, /** @type {any} */ (release));
    frame.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") { this.read(null); this.probe.textContent = ""; } });
    frame.addEventListener("wheel", (event) => {
      // At first the wheel is the page's; a pinch on a touchpad comes with Ctrl.
      if (!event.ctrlKey && this.scale === null && !this.full) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / (event.ctrlKey ? 100 : 400)), [event.clientX, event.clientY]);
    }, { passive: false });
    frame.addEventListener("dblclick", (event) => {
      if (this.tool || event.target instanceof HTMLVideoElement) return;
      if (this.scale === null) this.rescale(Math.max(1 / devicePixelRatio, 2 * this.fitting), [event.clientX, event.clientY]);
      else this.fit();
    });
    frame.addEventListener("keydown", (event) => {
      if (event.target !== frame || event.ctrlKey || event.metaKey || event.altKey) return;
      const arrow = ARROWS[event.key];
      if (event.key === "+" || event.key === "=") this.zoom(STEP);
      else if (event.key === "-") this.zoom(1 / STEP);
      else if (event.key === "0") this.fit();
      else if (event.key === "f" || (event.key === "Escape" && this.full)) this.fill();
      else if (arrow && this.scale !== null) this.shift(arrow[0] * 50, arrow[1] * 50);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    document.addEventListener("fullscreenchange", () => this.lay());
  }

  get full() {
    return document.fullscreenElement === this.element || this.element.classList.contains("full");
  }

  /** Move by so much of the screen. @param {number} right @param {number} down */
  shift(right, down) {
    const [width, height] = this.pixels;
    const scale = this.scale ?? this.fitting;
    this.middle = [this.middle[0] + right / (width * scale), this.middle[1] + down / (height * scale)];
    this.lay();
  }

  /** Say that the picture is of the run before, until another is shown. */
  age() {
    if (this.element.classList.contains("previous")) return;
    this.element.classList.add("previous");
    this.title.textContent = `Previous picture: ${this.title.textContent}`;
  }

  /** Another picture is shown. @param {string} title @param {Values | null} [values] */
  renew(title, values = null) {
    this.element.classList.remove("previous");
    this.title.textContent = title;
    this.values = values;
    fill(this.probe);
    this.lay();
  }
}
