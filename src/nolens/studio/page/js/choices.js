// @ts-check
/** Files and cameras to choose from. */

import { fileUrl, list, onDisk, studio } from "./api.js";
import { h } from "./dom.js";
import { folderOf } from "./format.js";

/** @typedef {{value: string, label: string}} Choice */
/** @typedef {{name: string, path: string, kind: string, bytes: number, changed: number}} Entry */
/** @typedef {{id: string, name: string, note: string, trouble: string | null, psfs: {path: string, distance: string, angle: string[]}[]}} Camera */

/** A folder's entries, none where it is not there yet. @param {string} path @returns {Promise<Entry[]>} */
async function entries(path) {
  try {
    return await list(path);
  } catch {
    return [];
  }
}

/** Folders in which files are looked for: some of the workspace's, and the ones that were named. @param {string[]} own */
async function places(own) {
  const { folders } = await studio();
  const [work, ...more] = folders.map((/** @type {any} */ each) => each.id);
  const named = await Promise.all(more.map(async (/** @type {string} */ id) =>
    [id, ...(await entries(id)).filter((each) => each.kind === "folder").map((each) => each.path)]));
  return [...own.map((name) => `${work}/${name}`), ...named.flat()];
}

/** The newest first. @param {Entry} one @param {Entry} other */
const byTime = (one, other) => other.changed - one.changed || other.name.localeCompare(one.name);

/** @typedef {{place: string, label: string, files: Entry[]}} Group files of a folder, and what it is called */

/** Files of some kinds, by folder. @param {(entry: Entry) => boolean} fits @param {string[]} [own] of the workspace's folders @returns {Promise<Group[]>} */
export async function filesBy(fits, own = ["shots", "uploads", "pictures"]) {
  const found = await Promise.all((await places(own)).map(async (place) => ({
    place, label: (await onDisk(place)).split("/").slice(-2).join("/"), files: (await entries(place)).filter(fits).sort(byTime) })));
  return found.filter(({ files }) => files.length > 0);
}

/** @param {HTMLSelectElement} select @param {Group[]} groups @param {string} none @param {Choice[]} [first] choices that come before the files */
export function offerFiles(select, groups, none, first = []) {
  replaceChoices(select, [h("option", { value: "" }, none), ...first.map(choiceOf), ...groups.map(groupOf)]);
}

/** Files after the choices that a select has. @param {HTMLSelectElement} select @param {Group[]} groups */
export function offerFilesToo(select, groups) {
  replaceChoices(select, [...select.querySelectorAll(":scope > option"), ...groups.map(groupOf)]);
}

const choiceOf = (/** @type {Choice} */ { value, label }) => h("option", { value }, label);

/** @param {Group} group */
function groupOf({ label, files }) {
  const element = h("optgroup", {}, ...files.map(({ path, name }) => choiceOf({ value: path, label: name })));
  element.label = label;
  return element;
}

/** What was chosen stays where it is still there, or else the first is. @param {HTMLSelectElement} select @param {Element[]} choices */
function replaceChoices(select, choices) {
  const before = select.value;
  select.replaceChildren(...choices);
  select.value = before;
  if (select.selectedIndex < 0) select.selectedIndex = 0;
}

/** All cameras: presets and folders. @returns {Promise<Camera[]>} */
export const cameras = async () => (await studio(true)).cameras;

/** A description to choose from. @param {Camera} camera @returns {Choice} */
export const cameraChoice = ({ id, name, trouble }) => ({
  value: id,
  label: `${id.includes("/") ? `${name} (${id})` : name}${trouble ? " – cannot be read" : ""}`,
});

const isAside = (/** @type {string[]} */ angle) => angle.some((each) => Number.parseFloat(each) !== 0);

/** Lists of PSFs at several angles, which are used together. @returns {Promise<Choice[]>} */
export const fieldPsfChoices = async () => (await cameras()).filter(({ psfs }) => psfs.some(({ angle }) => isAside(angle)))
  .map(({ id }) => ({ value: `${id}/psfs.toml`, label: `${id.split("/").pop()}: PSFs over the field` }));

/** PSFs in the folders of cameras. @returns {Promise<Choice[]>} */
export const psfChoices = async () => (await cameras()).flatMap((camera) =>
  camera.psfs.map(({ path, distance, angle }) => {
    const aside = isAside(angle) ? ` at ${angle.join(", ")}` : "";
    return { value: path, label: `${camera.id.split("/").pop()}: ${distance}${aside}` };
  }));

/** Folders of cameras that have a PSF. @returns {Promise<Choice[]>} */
export const calibratedCameras = async () => (await cameras()).filter(({ psfs }) => psfs.length > 0)
  .map(({ id, psfs }) => ({ value: id, label: `${id.split("/").pop()} (${psfs.length} ${psfs.length === 1 ? "PSF" : "PSFs"})` }));

/**
 * The PSF that a saved frame was reconstructed with, as its record says.
 *
 * @param {string} raw path of the frame
 * @param {Choice[]} psfs
 * @returns {Promise<Choice | undefined>}
 */
export async function psfOf(raw, psfs) {
  const record = raw.replace(/\.[^./]+$/, ".json");
  if (!(await entries(folderOf(raw))).some(({ path }) => path === record)) return undefined;
  const { inputs } = await (await fetch(fileUrl(record))).json();
  // The record has the path on the disk, and a path here begins with the name of its folder.
  return psfs.find(({ value }) => value.includes("/") && inputs?.psf?.path?.endsWith(value.slice(value.indexOf("/"))));
}
