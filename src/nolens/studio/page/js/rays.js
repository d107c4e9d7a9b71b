// @ts-check
/**
 * Rays of a far point source through plane layers and a lenslet. A ray is known by p = n sin θ, which plane
 * layers do not change; a lenslet of radius R changes it by −h (n' − n) / R at the height h.
 */

/** @typedef {{thickness_mm: number, index: number}} Layer */
/** @typedef {{layers: Layer[], mask: number, radius_mm: number | null}} Stack `mask`: number of the surface with the relief */

/** Slope of a ray. @param {number} p @param {number} index */
const slope = (p, index) => p / Math.sqrt(Math.max(1e-9, index * index - p * p));

/** What the lenslet adds to p at a height. @param {Stack} stack @param {number} height_mm */
function bend(stack, height_mm) {
  if (stack.radius_mm === null) return 0;
  const before = stack.mask === 0 ? 1 : stack.layers[stack.mask - 1].index;
  const after = stack.layers[stack.mask]?.index ?? 1;
  return (-height_mm * (after - before)) / stack.radius_mm;
}

/**
 * Where a ray goes, from above the camera to the sensor.
 *
 * @param {Stack} stack
 * @param {number} lens_mm middle of the lenslet
 * @param {number} height_mm of the ray over it
 * @param {number} angle_rad of the light
 * @param {number} above_mm where the ray begins
 * @returns {[number, number][]} places (across, depth) in mm
 */
export function trace(stack, lens_mm, height_mm, angle_rad, above_mm) {
  const start = Math.sin(angle_rad);
  const before = stack.layers.slice(0, stack.mask);
  // The ray meets the lenslet at its height, so the layers before it are gone through backwards.
  let across = lens_mm + height_mm;
  let depth = before.reduce((sum, each) => sum + each.thickness_mm, 0);
  /** @type {[number, number][]} */
  const places = [[across, depth]];
  for (const layer of [...before].reverse()) {
    across -= slope(start, layer.index) * layer.thickness_mm;
    depth -= layer.thickness_mm;
    places.unshift([across, depth]);
  }
  places.unshift([across - slope(start, 1) * above_mm, depth - above_mm]);
  [across, depth] = places[places.length - 1];
  const p = start + bend(stack, height_mm);
  for (const layer of stack.layers.slice(stack.mask)) {
    across += slope(p, layer.index) * layer.thickness_mm;
    depth += layer.thickness_mm;
    places.push([across, depth]);
  }
  return places;
}

/** How wide a lenslet's light is on the sensor, from edge to edge. @param {Stack} stack @param {number} pitch_mm @param {number} angle_rad */
export function blur(stack, pitch_mm, angle_rad) {
  const [one, other] = [-pitch_mm / 2, pitch_mm / 2].map((height) =>
    trace(stack, 0, height, angle_rad, 0).at(-1)?.[0] ?? 0);
  return Math.abs(other - one);
}
