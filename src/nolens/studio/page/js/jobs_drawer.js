// @ts-check
/** The drawer with all jobs, found again after a reload. */

import { get } from "./api.js";
import { button, fill, h } from "./dom.js";
import { board, cancel, ended, fileLinks, isDark, progressText, read } from "./jobs.js";
import { told } from "./notices.js";

const LOOK_MS = 1000;
// These follow a slider or a choice, and are no work that a person thinks of as a job.
const UNSEEN = ["design-look", "preview"];

/** @typedef {import("./jobs.js").Job} Job */

/** @param {Job} job */
function shown(job) {
  const running = !ended(job);
  const bar = h("progress", { max: 1, "aria-label": `Progress of ${job.title}` });
  if (typeof job.progress?.fraction === "number") bar.value = job.progress.fraction;
  return h("article", { class: "job" },
    h("div", { class: "row" }, h("b", {}, job.title), h("span", { class: `state ${job.status}` }, job.status)),
    job.status === "running" && bar,
    running && h("div", { class: "row" }, h("span", { class: "job-text" }, progressText(job)),
      button("Cancel", told(() => cancel(job.id)), { "aria-label": `Cancel ${job.title}` })),
    job.error && h("p", { class: "trouble" }, job.error),
    job.outputs?.length ? h("details", {}, h("summary", {}, `${job.outputs.filter((each) => !isDark(each)).length} files`), fileLinks(job.outputs)) : null);
}

/** Make the drawer work. @returns {{close: () => boolean}} */
export function jobsDrawer() {
  const drawer = /** @type {HTMLElement} */ (document.getElementById("jobs"));
  const opener = /** @type {HTMLButtonElement} */ (document.getElementById("jobs-button"));
  const count = /** @type {HTMLElement} */ (document.getElementById("jobs-count"));
  const list = h("div", {});
  const said = h("p", { class: "unseen", role: "status" });
  /** @type {Map<string, string>} */
  const states = new Map();
  let timer = 0;
  let before = "";

  const look = async () => {
    clearTimeout(timer);
    let busy = false;
    try {
      const jobs = /** @type {Job[]} */ ((await get("api/jobs")).jobs).filter((job) => !UNSEEN.includes(job.kind)).map(read);
      const running = jobs.filter((job) => !ended(job)).length;
      busy = running > 0;
      count.textContent = String(running);
      count.hidden = !busy;
      for (const job of jobs) {
        const old = states.get(job.id);
        if (old && old !== job.status) said.textContent = `${job.title}: ${job.status}`;
        states.set(job.id, job.status);
      }
      const now = JSON.stringify(jobs);
      if (!drawer.hidden && now !== before) {
        before = now;
        // A list that is built anew closes what was opened and loses the focus.
        const open = new Set([...list.querySelectorAll("details[open]")].map((each) => each.closest("[data-job]")?.getAttribute("data-job")));
        const focused = document.activeElement?.closest("[data-job]")?.getAttribute("data-job");
        fill(list, jobs.length ? jobs.map((job) => {
          const element = shown(job);
          element.dataset.job = job.id;
          if (open.has(job.id)) element.querySelector("details")?.setAttribute("open", "");
          return element;
        }) : h("p", { class: "pale" }, "No jobs yet. Reconstructions, calibrations and measurements are listed here."));
        if (focused) /** @type {HTMLElement | null} */ (list.querySelector(`[data-job="${focused}"] button, [data-job="${focused}"] summary`))?.focus();
      }
    } catch {
      busy = true; // The studio is away: look again.
    }
    if (busy || !drawer.hidden) timer = setTimeout(look, LOOK_MS);
  };

  const close = () => {
    if (drawer.hidden) return false;
    drawer.hidden = true;
    opener.setAttribute("aria-expanded", "false");
    opener.focus();
    return true;
  };
  opener.addEventListener("click", () => {
    if (close()) return;
    drawer.hidden = false;
    before = "";
    opener.setAttribute("aria-expanded", "true");
    drawer.focus();
    look();
  });
  fill(drawer, h("div", { class: "row" }, h("h2", { class: "grow" }, "Jobs"), button("Close", close)), list);
  document.body.append(said);
  board.addEventListener("change", look);
  look();
  return { close };
}
