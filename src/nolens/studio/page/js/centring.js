// @ts-check
/** A cross in the middle of the sensor, and where the PSF of a point source lies beside it. */

import { h, svg } from "./dom.js";

const SAMPLES = [96, 72];
const EVERY_MS = 400;
const CENTRED_FRACTION = 0.02;
const FLOOR = 0.25;
/** Of R + G + B: less than this between dark and bright is noise. */
const LEAST_CONTRAST = 60;

/**
 * Where the middle of what is bright lies, from −1 to 1 in each direction.
 *
 * @param {Uint8ClampedArray} rgba
 * @param {number} columns
 * @returns {[number, number] | null} (to the right, up); null where nothing is bright
 */
export function brightMiddle(rgba, columns) {
  const values = [];
  for (let at = 0; at < rgba.length; at += 4) values.push(rgba[at] + rgba[at + 1] + rgba[at + 2]);
  const [lowest, highest] = [Math.min(...values), Math.max(...values)];
  if (highest - lowest < LEAST_CONTRAST) return null;
  const floor = lowest + FLOOR * (highest - lowest);
  let [sum, right, down] = [0, 0, 0];
  values.forEach((value, place) => {
    const light = Math.max(0, value - floor);
    sum += light;
    right += light * ((place % columns) + 0.5);
    down += light * (Math.floor(place / columns) + 0.5);
  });
  const rows = values.length / columns;
  return [(2 * right) / (sum * columns) - 1, 1 - (2 * down) / (sum * rows)];
}

/** @param {number} fraction @param {string} one @param {string} other */
const side = (fraction, one, other) => `${Math.abs(50 * fraction).toFixed(0)} % too far ${fraction > 0 ? one : other}`;

export class Centring {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.small = h("canvas", { width: SAMPLES[0], height: SAMPLES[1] });
    this.said = h("span", {});
    this.dot = svg("circle", { class: "found", r: 2.2, visibility: "hidden" });
    this.lines = svg("path");
    this.overlay = svg("svg", { class: "cross", "aria-hidden": "true" }, this.lines, this.dot);
    this.half = 75;
    this.looked_ms = 0;
  }

  /** Lay the cross over the picture, 200 wide and as high as that is. */
  fit() {
    const half = (100 * this.canvas.height) / this.canvas.width;
    this.half = half;
    this.overlay.setAttribute("viewBox", `0 0 200 ${2 * half}`);
    this.lines.setAttribute("d", `M100 0V${half - 10}M100 ${half + 10}V${2 * half}M0 ${half}H90M110 ${half}H200`
      + `M90 ${half}a10 10 0 0 0 20 0a10 10 0 0 0 -20 0`);
  }

  /**
   * Look where the light is, not more often than it can be read.
   *
   * @param {boolean | null} point whether it comes from a point source; null where only a person can know
   */
  look(point) {
    if (performance.now() - this.looked_ms < EVERY_MS) return;
    this.looked_ms = performance.now();
    this.fit();
    const context = this.small.getContext("2d", { willReadFrequently: true });
    if (!context) return;
    context.drawImage(this.canvas, 0, 0, SAMPLES[0], SAMPLES[1]);
    const middle = brightMiddle(context.getImageData(0, 0, SAMPLES[0], SAMPLES[1]).data, SAMPLES[0]);
    if (middle === null) {
      this.said.textContent = "Nothing bright is in view";
      this.dot.setAttribute("visibility", "hidden");
      return;
    }
    if (point === false) {
      this.said.textContent = "The camera looks at no point source";
      this.dot.setAttribute("visibility", "hidden");
      return;
    }
    const [right, up] = middle;
    this.dot.setAttribute("visibility", "visible");
    this.dot.setAttribute("cx", (100 + 100 * right).toFixed(1));
    this.dot.setAttribute("cy", (this.half * (1 - up)).toFixed(1));
    const far = [
      Math.abs(right) > CENTRED_FRACTION * 2 && side(right, "right", "left"),
      Math.abs(up) > CENTRED_FRACTION * 2 && side(up, "up", "down"),
    ].filter(Boolean);
    this.said.textContent = `The ${point ? "PSF" : "light"} is ${far.join(", ") || "in the middle"}`;
  }
}
