// @ts-check
/** The layers to scale, with light on its way through them. */

import { svg } from "./dom.js";
import { mm } from "./format.js";
import { trace } from "./rays.js";

const WIDTH = 560;
const ABOVE_FRACTION = 0.22;
const SENSOR_PX = 10;
const RELIEF_PX = 5;
const READABLE_PX = 15;
const LENSES = [-0.28, 0, 0.28];
const WIDER = 1.35;
/** The same for all stacks, as each fills the drawing. */
const HEIGHT = Math.ceil((WIDTH * (1 + ABOVE_FRACTION)) / WIDER) + SENSOR_PX;

/** An empty place of the drawing's size, so that nothing moves when it comes. */
export const noDrawing = () => svg("svg", { class: "stack", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" });

/** Colours of the layers, by place; the sliders beside the drawing have the same. @param {number} place @param {boolean} air */
export const layerClass = (place, air) => (air ? "layer air" : `layer layer-${place % 4}`);

/** @param {number} index */
export const isAir = (index) => index < 1.05;

/**
 * @param {{layers: {name: string, material: string, thickness_mm: number, index: number}[], mask_surface: number,
 *   radius_mm: number | null, pitch_um: number | null}} look
 * @param {number} angle_deg of the slanted light
 * @returns {SVGSVGElement}
 */
export function stackDrawing(look, angle_deg) {
  const total = look.layers.reduce((sum, each) => sum + each.thickness_mm, 0);
  const above = total * ABOVE_FRACTION;
  const wide = total * WIDER;
  const scale = WIDTH / wide;
  const x = (/** @type {number} */ across) => (across + wide / 2) * scale;
  const y = (/** @type {number} */ depth) => (depth + above) * scale;
  const image = svg("svg", { class: "stack", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" },
    svg("title", {}, `Layers to scale, ${mm(total)} from mask to sensor, with rays from a distant source`));

  let depth = 0;
  const names = [];
  look.layers.forEach((layer, place) => {
    const tall = layer.thickness_mm * scale;
    image.append(svg("rect", { class: layerClass(place, isAir(layer.index)), x: 0, y: y(depth), width: WIDTH, height: tall }));
    if (tall >= READABLE_PX) {
      names.push(svg("text", { x: 8, y: y(depth) + tall / 2 + 4 }, layer.name),
        svg("text", { x: WIDTH - 8, y: y(depth) + tall / 2 + 4, "text-anchor": "end" }, `n ${layer.index.toFixed(3)}`));
    }
    depth += layer.thickness_mm;
  });
  image.append(svg("rect", { class: "sensor", x: 0, y: y(total), width: WIDTH, height: SENSOR_PX }));
  if (look.pitch_um) image.append(relief(look, wide, x, y));

  const half = (look.pitch_um ?? 0) / 2000;
  const stack = { layers: look.layers, mask: look.mask_surface, radius_mm: look.radius_mm };
  const pitch = half * 2 || 1;
  for (const [angle, look_of] of /** @type {[number, string][]} */ ([[0, "straight"], [angle_deg, "slanted"]])) {
    if (look_of === "slanted" && angle === 0) continue;
    for (const fraction of LENSES) {
      const lens = Math.round((fraction * wide) / pitch) * pitch;
      for (const [ray, name] of /** @type {[number, string][]} */ ([[-half, "marginal"], [half, "marginal"], [0, "chief"]])) {
        const places = trace(stack, lens, ray, (angle * Math.PI) / 180, above);
        image.append(svg("polyline", { class: `ray ${look_of} ${name}`,
          points: places.map(([across, down]) => `${x(across).toFixed(1)},${y(down).toFixed(1)}`).join(" ") }));
      }
    }
  }
  image.append(...names, scaleBar(scale));
  return image;
}

/** Lenslets on the mask's surface, their heights enlarged. @param {any} look @param {number} wide @param {(v: number) => number} x @param {(v: number) => number} y */
function relief(look, wide, x, y) {
  const pitch = look.pitch_um / 1000;
  const top = y(look.layers.slice(0, look.mask_surface).reduce((/** @type {number} */ sum, /** @type {any} */ each) => sum + each.thickness_mm, 0));
  const count = Math.ceil(wide / pitch / 2) + 1;
  let path = `M${x((-count - 0.5) * pitch).toFixed(1)} ${top}`;
  for (let number = -count; number <= count; number++) {
    path += `Q${x(number * pitch).toFixed(1)} ${top - 2 * RELIEF_PX} ${x((number + 0.5) * pitch).toFixed(1)} ${top}`;
  }
  return svg("path", { class: `${layerClass(look.mask_surface, isAir(look.layers[look.mask_surface]?.index ?? 1))} relief`, d: `${path}Z` });
}

/** @param {number} scale pixels for a millimetre */
function scaleBar(scale) {
  const length = [1, 0.5, 0.2, 0.1].find((each) => each * scale < WIDTH / 3) ?? 0.1;
  const at = 28;
  return svg("g", { class: "scale" },
    svg("path", { d: `M${WIDTH - 10} ${at}h${-length * scale}m0 -4v8m${length * scale} 0v-8` }),
    svg("text", { x: WIDTH - 10 - (length * scale) / 2, y: at - 5, "text-anchor": "middle" }, `${length} mm`));
}
