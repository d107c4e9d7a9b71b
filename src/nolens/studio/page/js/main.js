// @ts-check
/** The page: panels by address, keys, theme, drawer. */

import { calibratePanel } from "./calibrate.js";
import { designPanel } from "./design.js";
import { jobsDrawer } from "./jobs_drawer.js";
import { measurePanel } from "./measure.js";
import { dismiss, trouble } from "./notices.js";
import { declarations } from "./names.js";
import { photographPanel } from "./photograph.js";
import { viewfinderPanel } from "./viewfinder.js";

/** @typedef {{enter?: () => void, leave?: () => void, key?: (key: string, control?: boolean, shift?: boolean) => boolean}} Panel */

/** @type {Record<string, (place: HTMLElement) => Panel>} */
const MAKERS = {
  viewfinder: viewfinderPanel,
  design: designPanel,
  calibrate: calibratePanel,
  photograph: photographPanel,
  measure: measurePanel,
};
const NAMES = Object.keys(MAKERS);

/** @type {Record<string, Panel>} */
const panels = {};
let current = "";

/** Show the panel that the address names; one is made when it is first shown. */
async function route() {
  const [asked] = location.hash.slice(1).split("?");
  const name = NAMES.includes(asked) ? asked : NAMES[0];
  if (name === current) return;
  panels[current]?.leave?.();
  current = name;
  const places = /** @type {HTMLElement[]} */ ([...document.querySelectorAll("[data-panel]")]);
  for (const place of places) place.hidden = place.dataset.panel !== name;
  for (const link of document.querySelectorAll(".tabs a")) {
    if (link.getAttribute("href") === `#${name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  document.title = `${name[0].toUpperCase()}${name.slice(1)} · nolens studio`;
  const place = /** @type {HTMLElement} */ (places.find((each) => !each.hidden));
  if (!(name in panels)) {
    if (name !== "viewfinder") await declarationsFor(place);
    if (name !== current || name in panels) return;
    panels[name] = MAKERS[name](place);
  }
  panels[name].enter?.();
}

/** Wait for the names of the panel's options, which come seconds after the studio was started. @param {HTMLElement} place */
async function declarationsFor(place) {
  place.setAttribute("aria-busy", "true");
  await declarations;
  place.removeAttribute("aria-busy");
}

/** Dark or light, as chosen or as the system says. */
function themeSwitch() {
  const button = /** @type {HTMLButtonElement} */ (document.getElementById("theme-button"));
  const system = matchMedia("(prefers-color-scheme: dark)");
  const dark = () => (document.documentElement.dataset.theme ?? (system.matches ? "dark" : "light")) === "dark";
  const tell = () => {
    const text = `Switch to the ${dark() ? "light" : "dark"} theme`;
    button.setAttribute("aria-label", text);
    button.title = text;
  };
  button.addEventListener("click", () => {
    const theme = dark() ? "light" : "dark";
    document.documentElement.dataset.theme = theme;
    try {
      localStorage.setItem("nolens-theme", theme);
    } catch {
      // It holds for this visit then.
    }
    tell();
  });
  system.addEventListener("change", tell);
  tell();
}

const drawer = jobsDrawer();

/** @param {KeyboardEvent} event */
function keys(event) {
  const control = event.ctrlKey || event.metaKey;
  if (event.altKey || event.repeat) return;
  if (event.key === "Escape") {
    if (!drawer.close()) dismiss();
    return;
  }
  const target = /** @type {HTMLElement} */ (event.target);
  const range = target instanceof HTMLInputElement && target.type === "range";
  if (target.closest("input, select, textarea") && !range) return;
  if (event.key === " " && target.closest("button, a, summary")) return;
  const place = Number(event.key) - 1;
  if (place in NAMES && !control) location.hash = NAMES[place];
  else if (!panels[current]?.key?.(event.key, control, event.shiftKey)) return;
  event.preventDefault();
}

addEventListener("click", (event) => {
  // After a click with the pointer the keys are the panel's again, and not those of what was clicked.
  const target = /** @type {HTMLElement} */ (event.target);
  if (event.detail > 0) /** @type {HTMLElement | null} */ (target.closest("button, summary, input[type=checkbox]"))?.blur();
});
document.getElementById("skip")?.addEventListener("click", (event) => {
  event.preventDefault();
  document.getElementById("main")?.focus();
});
addEventListener("keydown", keys);
addEventListener("hashchange", route);
addEventListener("unhandledrejection", (event) => trouble(event.reason));
themeSwitch();
route();
