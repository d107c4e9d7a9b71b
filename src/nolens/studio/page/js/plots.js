// @ts-check
/** Curves with axes. */

import { svg } from "./dom.js";
import { number } from "./format.js";

const WIDTH = 360;
const HEIGHT = 210;
const BOX = { left: 52, right: 10, top: 10, bottom: 40 };

/** Round values that divide a range. @param {number} low @param {number} high @param {number} [about] */
function ticks(low, high, about = 5) {
  const rough = (high - low) / about || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough) ?? rough;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-9; value += step) {
    found.push(Math.abs(value) < step * 1e-9 ? 0 : value);
  }
  return found;
}

/** Powers of ten in a range; where there are fewer than two, round values. @param {number} low @param {number} high */
function logTicks(low, high) {
  const powers = [];
  for (let power = Math.ceil(Math.log10(low)); power <= Math.log10(high); power++) powers.push(10 ** power);
  const every = Math.ceil(powers.length / 6);
  return powers.length < 2 ? ticks(low, high, 3).filter((each) => each > 0)
    : powers.filter((_, place) => place % every === 0);
}

/**
 * A curve.
 *
 * @param {{x: number[], y: number[], xLabel: string, yLabel: string, title: string, log?: boolean,
 *   from?: number}} given `from`: a value that the upright axis has at least to reach
 * @returns {SVGSVGElement}
 */
export function curve(given) {
  const { x, y, log = false } = given;
  const shown = x.map((each, place) => [each, y[place]])
    .filter(([, up]) => Number.isFinite(up) && (!log || up > 0));
  if (shown.length === 0) return noCurve();
  const xs = shown.map(([each]) => each);
  const ys = shown.map(([, each]) => each);
  const [xLow, xHigh] = [Math.min(...xs), Math.max(...xs)];
  const reached = given.from === undefined ? ys : [...ys, given.from];
  let [low, high] = [Math.min(...reached), Math.max(...reached)];
  if (!(high > low)) [low, high] = log ? [low / 2, low * 2] : [low - 1, low + 1];
  const across = (/** @type {number} */ value) =>
    BOX.left + ((value - xLow) / (xHigh - xLow || 1)) * (WIDTH - BOX.left - BOX.right);
  const scaled = (/** @type {number} */ value) => (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
  const up = (/** @type {number} */ value) => HEIGHT - BOX.bottom - scaled(value) * (HEIGHT - BOX.top - BOX.bottom);
  const [right, bottom] = [WIDTH - BOX.right, HEIGHT - BOX.bottom];

  const image = svg("svg", { class: "plot", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" },
    svg("title", {}, given.title));
  for (const value of log ? logTicks(low, high) : ticks(low, high)) {
    image.append(svg("path", { class: "grid", d: `M${BOX.left} ${up(value)}H${right}` }),
      svg("text", { x: BOX.left - 6, y: up(value) + 4, "text-anchor": "end" }, number(value, 2)));
  }
  for (const value of ticks(xLow, xHigh)) {
    image.append(svg("path", { class: "axis", d: `M${across(value)} ${bottom}v4` }),
      svg("text", { x: across(value), y: bottom + 17, "text-anchor": "middle" }, number(value)));
  }
  const points = shown.map(([one, other]) => `${across(one).toFixed(2)},${up(other).toFixed(2)}`);
  image.append(
    svg("path", { class: "axis", d: `M${BOX.left} ${BOX.top}V${bottom}H${right}` }),
    svg("polyline", { class: "curve", points: points.join(" ") }),
    svg("text", { x: (BOX.left + right) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, given.xLabel),
    svg("text", { x: 12, y: (BOX.top + bottom) / 2, "text-anchor": "middle",
      transform: `rotate(-90 12 ${(BOX.top + bottom) / 2})` }, given.yLabel));
  return image;
}

/** An empty place of a curve's size, so that nothing moves when it comes. */
export const noCurve = () => svg("svg", { class: "plot", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" },
  svg("path", { class: "axis", d: `M${BOX.left} ${BOX.top}V${HEIGHT - BOX.bottom}H${WIDTH - BOX.right}` }));
