// @ts-check
/** Raw counts by colour, and what they say about the exposure. */

import { fill, h, svg } from "./dom.js";
import { percent } from "./format.js";

const WIDTH = 320;
const HEIGHT = 90;
const BRIGHT_FRACTION = 1e-3;
const DARK_LEVEL = 0.35;
const CLIPPED_FRACTION = 1e-4;

/** @typedef {"too dark" | "right" | "clipped"} ExposureWord */

const SAID = /** @type {Record<ExposureWord, [string, string, string]>} */ ({
  "too dark": ["Too dark", "", "Lengthen the exposure, or bring more light."],
  right: ["Exposure right", "good", "Bright, and nothing is saturated."],
  clipped: ["Clipped", "bad", "Shorten the exposure, or dim the light."],
});

/**
 * What a person should know of an exposure.
 *
 * @param {Record<string, number[]>} histogram counts from black to white
 * @param {number} clippedFraction
 * @returns {ExposureWord}
 */
export function exposureWord(histogram, clippedFraction) {
  if (clippedFraction > CLIPPED_FRACTION) return "clipped";
  let level = 0;
  for (const counts of Object.values(histogram)) {
    const wanted = BRIGHT_FRACTION * counts.reduce((sum, each) => sum + each, 0);
    let above = 0;
    let bin = counts.length;
    while (bin > 0 && above < wanted) above += counts[--bin];
    level = Math.max(level, (bin + 1) / counts.length);
  }
  return level < DARK_LEVEL ? "too dark" : "right";
}

/** @param {ExposureWord} word */
export const exposureAdvice = (word) => SAID[word][2];

/** A histogram that follows the frames. */
export class Histogram {
  constructor() {
    this.plot = svg("svg", { class: "histogram", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img",
      preserveAspectRatio: "none", "aria-label": "Histogram of the raw counts by colour" });
    this.verdict = h("span", { class: "verdict" });
    this.clipped = h("span", { class: "pale" });
    this.element = h("div", {}, this.plot, h("div", { class: "words" }, this.verdict, this.clipped));
    /** @type {ExposureWord | null} */
    this.word = null;
  }

  /** @param {Record<string, number[]>} histogram @param {number} clippedFraction */
  show(histogram, clippedFraction) {
    // Roots, so that the few bright pixels, which matter most, are seen beside the many dark ones.
    const most = Math.max(1, ...Object.values(histogram).flat());
    const curves = Object.entries(histogram).map(([name, counts]) => {
      const points = counts.map((count, bin) => {
        const y = (HEIGHT - 2 - (HEIGHT - 8) * Math.sqrt(count / most)).toFixed(1);
        const [from, to] = [bin, bin + 1].map((each) => ((each / counts.length) * WIDTH).toFixed(1));
        return `${from},${y} ${to},${y}`;
      });
      return svg("polyline", { points: points.join(" "), class: `counts ${name}` });
    });
    this.word = exposureWord(histogram, clippedFraction);
    const mark = svg("rect", { x: WIDTH - 5, y: 0, width: 5, height: HEIGHT, class: "clipping" });
    fill(this.plot, curves, this.word === "clipped" && mark);
    const [text, look] = SAID[this.word];
    this.verdict.textContent = text;
    this.verdict.className = `verdict ${look}`;
    this.clipped.textContent = `${percent(clippedFraction)} clipped`;
  }
}
