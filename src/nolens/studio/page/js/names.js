// @ts-check
/** What the page calls the options of each kind of job: on its fields, and in what the studio says. */

const READING = {
  dark: "Dark frame", black: "Black level", white: "Saturated from", mosaic: "Colour mosaic",
  bgr: "Channels in the order B, G, R", channels: "Channels", bin: "Binning", region: "Support of the scene",
  flip: "Turn the picture", tau: "τ, weight of the prior", iterations: "Iterations, at most",
};

/** @type {Record<string, Record<string, string>>} by kind of job, then by option */
export const NAMES = {
  reconstruct: {
    ...READING, measurement: "Raw file", psf: "PSF", psf_scale: "PSF pixels finer by", psf_wider: "Extended PSF",
    quality: "Quality", field: "Field of view from side to side", camera: "PSF",
  },
  refocus: { ...READING, measurement: "Raw file", psfs: "Camera", stack: "Nearest and Farthest", steps: "Depths" },
  calibrate: {
    camera: "Description", name: "Folder of its PSFs", distance: "Distance from the mask", frames: "Frames", dark: "Dark frames",
  },
  fabricate: { camera: "Description", thickness: "Layers" },
  "design-look": { camera: "Description", thickness: "Layers" },
  "measure-psf": { psf: "PSF" },
  "measure-two-points": { simulate: "Camera", distance: "Distance", draws: "Repeats" },
  "measure-siemens": { simulate: "Camera", camera: "Camera", angle: "Field angle that it fills", frames: "Picture" },
  "measure-edge": { simulate: "Camera", camera: "Camera", angle: "Field angle that it fills", frames: "Picture" },
  "measure-field": {
    simulate: "Camera", camera: "Camera", psfs: "PSFs of", angles: "Half angles", dots: "Picture",
    dot_pitch: "Distance of the dots", distance: "Distance of the grid", reach: "Half angle with dots",
  },
};

/**
 * What the studio says of a job, with the page's fields in place of the command's options.
 *
 * @param {string} kind of the job
 * @param {string} text
 */
export function worded(kind, text) {
  const names = NAMES[kind] ?? {};
  return text
    .replace(/--([a-z][a-z-]*[a-z])/g, (flag, option) => {
      const name = names[option.replaceAll("-", "_")];
      return name ? `“${name}”` : `${flag} of the command line`;
    })
    .replace(/(^|; )([a-z_]+)(?= is )/g, (whole, before, option) => (names[option] ? `${before}“${names[option]}”` : whole));
}
