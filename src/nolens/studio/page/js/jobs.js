// @ts-check
/** Jobs of the worker: starting them, following them, and how one is shown. */

import { ApiError, fileUrl, get, post } from "./api.js";
import { button, fill, h } from "./dom.js";
import { baseName, left, pause } from "./format.js";
import { worded } from "./names.js";
import { trouble } from "./notices.js";

const LOOK_MS = 300;
const AWAY_MS = 1500;

/**
 * @typedef {object} Job
 * @property {string} id
 * @property {string} kind
 * @property {string} title
 * @property {"queued" | "running" | "done" | "failed" | "cancelled"} status
 * @property {{what?: string, fraction?: number | null, done?: number, limit?: number, seconds_left?: number | null} | null} progress
 * @property {{iteration: number, objective: number}[]} [history]
 * @property {string[]} [notes]
 * @property {string[]} [warnings]
 * @property {string | null} error
 * @property {any} [summary]
 * @property {string[]} [outputs]
 * @property {Record<string, any>} [options] as the page gave them
 * @property {string} [started]
 */

/** @param {Job} job */
export const ended = (job) => !["queued", "running"].includes(job.status);

/** Told when a job begins or ends. */
export const board = new EventTarget();
const changed = () => board.dispatchEvent(new Event("change"));

/** @param {string} kind @param {Record<string, unknown>} options @returns {Promise<string>} id */
export async function start(kind, options) {
  const given = Object.fromEntries(Object.entries(options).filter(([, value]) => value !== undefined && value !== ""));
  try {
    const { id } = await post("api/jobs", { kind, options: given });
    changed();
    return id;
  } catch (error) {
    if (error instanceof ApiError) throw new ApiError(error.status, worded(kind, error.message));
    throw error;
  }
}

/** A job as the server has it, with what it says in the page's words. @template {Job} J @param {J} job @returns {J} */
export const read = (job) => {
  const all = (/** @type {string[] | undefined} */ texts) => texts?.map((text) => worded(job.kind, text));
  return { ...job, error: job.error && worded(job.kind, job.error), notes: all(job.notes), warnings: all(job.warnings) };
};

/** @param {string} id @returns {Promise<Job>} */
export const cancel = (id) => post(`api/jobs/${encodeURIComponent(id)}/cancel`);

/**
 * Look at a job until it has ended. Where the studio is away for a while, it goes on looking.
 *
 * @param {string} id
 * @param {(job: Job) => void} [seen]
 * @param {AbortSignal} [signal] ends the looking, not the job
 * @returns {Promise<Job | null>} null where it was ended
 */
export async function follow(id, seen = () => {}, signal) {
  for (;;) {
    try {
      const job = read(/** @type {Job} */ (await get(`api/jobs/${encodeURIComponent(id)}`)));
      if (signal?.aborted) return null;
      seen(job);
      if (ended(job)) {
        changed();
        return job;
      }
      await pause(LOOK_MS);
    } catch (error) {
      if (!(error instanceof ApiError) || error.status !== 0) throw error;
      await pause(AWAY_MS);
    }
    if (signal?.aborted) return null;
  }
}

/** Start a job, and wait for its end. @param {string} kind @param {Record<string, unknown>} options @returns {Promise<Job>} */
export async function run(kind, options) {
  const job = await follow(await start(kind, options));
  if (job === null || job.status !== "done") throw new Error(job?.error ?? "The job was cancelled.");
  return job;
}

/** Open what hides a field that a text names. @param {HTMLElement} element of the field's group @param {string} text */
function reveal(element, text) {
  for (const details of element.closest(".group")?.querySelectorAll("details") ?? []) {
    const labels = [...details.querySelectorAll("label")];
    if (labels.some((each) => text.includes(`“${each.textContent}”`))) details.open = true;
  }
}

/** Whether a file is a plot for the dark theme. @param {string} path */
export const isDark = (path) => path.endsWith(".dark.png");

/** Links to the files of a job. @param {string[]} paths */
export const fileLinks = (paths) => h("ul", { class: "files" }, paths.filter((path) => !isDark(path)).map((path) =>
  h("li", {}, h("a", { href: fileUrl(path), download: baseName(path) }, baseName(path)))));

/** @param {Job} job */
export function progressText(job) {
  if (job.status === "queued") return "Waiting for the job before it";
  if (job.status === "cancelled") return "Cancelled";
  if (job.status !== "running") return "";
  const { what, done, limit, seconds_left } = job.progress ?? {};
  const rest = typeof seconds_left === "number" && seconds_left >= 1 ? ` · ${left(seconds_left)}` : "";
  if (what?.startsWith("%")) return `${done ?? 0} ${what}${rest}`;
  const steps = done && limit ? ` ${done} of ${limit}` : "";
  return `${what ?? "Working"}${steps}${rest}`;
}

/** One job as a panel shows it: progress, cancel, warnings, and why it failed. */
export class JobView {
  /** @param {{seen?: (job: Job) => void, keep?: string}} [given] `keep`: name under which a reload finds the job */
  constructor(given = {}) {
    this.given = given;
    /** @type {AbortController | null} */
    this.looking = null;
    this.id = "";
    this.bar = h("progress", { max: 1, value: 0, "aria-label": "Progress" });
    this.text = h("span", { class: "job-text", role: "status" });
    this.stop = button("Cancel", () => { this.stop.disabled = true; cancel(this.id).catch(trouble); });
    this.more = h("div", {});
    this.element = h("div", { class: "job", hidden: true }, this.bar,
      h("div", { class: "row" }, this.text, this.stop), this.more);
  }

  /** Start, and show it to its end. @param {string} kind @param {Record<string, unknown>} options @returns {Promise<Job | null>} the job if it is done */
  async run(kind, options) {
    fill(this.more);
    try {
      return await this.watch(await start(kind, options));
    } catch (error) {
      if (error instanceof Error) reveal(this.element, error.message);
      throw error;
    }
  }

  /** Show a job that has been started. @param {string} id @returns {Promise<Job | null>} */
  async watch(id) {
    this.looking?.abort();
    this.looking = new AbortController();
    this.id = id;
    this.element.hidden = false;
    this.stop.disabled = false;
    if (this.given.keep) sessionStorage.setItem(`nolens-${this.given.keep}`, id);
    const job = await follow(id, (each) => this.show(each), this.looking.signal);
    return job?.status === "done" ? job : null;
  }

  /** The job of before a reload, if there was one. @returns {Promise<Job | null>} */
  async again() {
    const id = this.given.keep ? sessionStorage.getItem(`nolens-${this.given.keep}`) : null;
    if (!id) return null;
    try {
      return await this.watch(id);
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) this.element.hidden = true;
      else trouble(error);
      return null;
    }
  }

  /** @param {Job} job */
  show(job) {
    const over = ended(job);
    const fraction = job.progress?.fraction ?? (job.progress?.limit ? (job.progress.done ?? 0) / job.progress.limit : null);
    this.bar.hidden = this.stop.hidden = over;
    if (fraction === null || fraction === undefined) this.bar.removeAttribute("value");
    else this.bar.value = fraction;
    this.text.textContent = progressText(job);
    fill(this.more,
      job.error && h("p", { class: "trouble", role: "alert" }, job.error),
      [...new Set(job.warnings ?? [])].map((text) => h("p", { class: "warning" }, text)));
    if (job.error) reveal(this.element, job.error);
    this.element.hidden = job.status === "done" && this.more.childElementCount === 0;
    this.given.seen?.(job);
  }
}
