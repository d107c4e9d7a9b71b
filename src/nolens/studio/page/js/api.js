// @ts-check
/** The studio's server, as functions. */

/** What the server refused, in its own words. */
export class ApiError extends Error {
  /** @param {number} status @param {string} text */
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

/**
 * @param {string} method
 * @param {string} path
 * @param {BodyInit | null} [body]
 * @param {Record<string, string>} [headers]
 * @returns {Promise<any>}
 */
async function ask(method, path, body = null, headers = {}) {
  let answer;
  try {
    // Small messages still go out where the page is being closed.
    answer = await fetch(path, { method, body, headers, keepalive: typeof body === "string" });
  } catch {
    throw new ApiError(0, "The studio does not answer. Is nolens studio still running?");
  }
  if (!answer.ok) throw new ApiError(answer.status, await refusal(answer));
  return answer.json();
}

/** @param {Response} answer */
async function refusal(answer) {
  try {
    const { detail } = await answer.json();
    if (typeof detail === "string") return detail;
    if (Array.isArray(detail)) return detail.map((each) => each.msg ?? String(each)).join("; ");
  } catch {
    // Not JSON: the status is all there is.
  }
  return `The studio answered ${answer.status} ${answer.statusText}`.trim();
}

/** @param {string} path */
export const get = (path) => ask("GET", path);

/** @param {string} path @param {unknown} [given] */
export const post = (path, given = {}) =>
  ask("POST", path, JSON.stringify(given), { "Content-Type": "application/json" });

/** A picture that becomes the twin's scene. @param {Blob} picture */
export const showScene = (picture) =>
  ask("POST", "api/live/scene", picture, { "Content-Type": picture.type });

/** Store a file of the visitor's. @param {File} file @returns {Promise<string>} its path */
export async function upload(file) {
  const about = await studio();
  if (file.size > about.upload_bytes) {
    throw new ApiError(413, `${file.name} has ${Math.ceil(file.size / 2 ** 20)} MiB; the studio takes `
      + `files of up to ${Math.floor(about.upload_bytes / 2 ** 20)} MiB. Copy it into a folder that `
      + "you name at the start: nolens studio FOLDER");
  }
  const name = encodeURIComponent(file.name);
  const type = { "Content-Type": "application/octet-stream" };
  return (await ask("POST", `api/uploads?name=${name}`, file, type)).path;
}

/** Address of a file's bytes. @param {string} path */
export const fileUrl = (path) => `api/file?path=${encodeURIComponent(path)}`;

/** @param {string} path @returns {Promise<{name: string, path: string, kind: string, bytes: number, changed: number}[]>} */
export const list = async (path) => (await get(`api/files?path=${encodeURIComponent(path)}`)).entries;

/** Where a path of the page lies on the disk. @param {string} path @returns {Promise<string>} */
export async function onDisk(path) {
  const [id, ...rest] = path.split("/");
  const { folders } = await studio();
  const root = folders.find((/** @type {any} */ each) => each.id === id);
  return [root?.path ?? id, ...rest].join("/");
}

/** @type {Promise<any> | null} */
let known = null;

/** What the studio has: folders, cameras, sources; asked once, or anew. @param {boolean} [anew] */
export function studio(anew = false) {
  if (known === null || anew) {
    known = get("api/about");
    known.catch(() => { known = null; });
  }
  return known;
}
