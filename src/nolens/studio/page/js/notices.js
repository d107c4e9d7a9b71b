// @ts-check
/** What went wrong, told where it is seen and read aloud. */

import { button, h } from "./dom.js";

const MOST = 3;

/** Show an error until it is dismissed; the same one only once. @param {unknown} error */
export function trouble(error) {
  const text = error instanceof Error ? error.message : String(error);
  const place = /** @type {HTMLElement} */ (document.getElementById("notices"));
  if ([...place.children].some((each) => each.firstChild?.textContent === text)) return;
  const notice = h("div", { class: "notice" }, h("span", {}, text),
    button("Dismiss", () => notice.remove()));
  place.append(notice);
  while (place.children.length > MOST) place.firstElementChild?.remove();
}

/** Dismiss the newest. @returns {boolean} whether there was one */
export function dismiss() {
  const last = document.getElementById("notices")?.lastElementChild;
  last?.remove();
  return Boolean(last);
}

/** A listener that tells what goes wrong in it. @template {any[]} A @param {(...given: A) => Promise<unknown>} work */
export const told = (work) => (/** @type {A} */ ...given) => {
  work(...given).catch(trouble);
};

/** The line under the header: connection and camera. @param {string} text @param {boolean} [bad] @param {HTMLElement} [more] */
export function banner(text, bad = false, more) {
  const place = /** @type {HTMLElement} */ (document.getElementById("banner"));
  if (place.dataset.text === text) return;
  place.dataset.text = text;
  place.hidden = text === "";
  place.classList.toggle("bad", bad);
  place.replaceChildren(text, ...(more ? [" ", more] : []));
}
