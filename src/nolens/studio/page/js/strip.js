// @ts-check
/** Pictures of a sweep side by side: a click shows one, and its setting can be taken. */

import { fileUrl } from "./api.js";
import { button, fill, h } from "./dom.js";
import { number } from "./format.js";
import { label } from "./names.js";
import { told } from "./notices.js";

/** @typedef {{file: string, settings: Record<string, any>, tau: number}} Row of the record */

/** What a person calls the setting of a picture. @param {Row} row */
const settingText = ({ settings }) => Object.entries(settings).map(([name, value]) =>
  `${label("reconstruct", name)} ${typeof value === "number" ? number(value, 2) : value ?? "without limit"}`).join(", ");

export class Strip {
  /**
   * @param {(file: string) => Promise<void>} show opens a picture of the sweep
   * @param {(settings: Record<string, any>) => Promise<void>} use takes its setting
   */
  constructor(show, use) {
    this.show = show;
    this.use = use;
    this.list = h("div", { class: "strip", role: "group", "aria-label": "Pictures with other settings" });
    this.taker = button("Use this setting", told(() => this.use(/** @type {Row} */ (this.chosen).settings)));
    this.text = h("span", { class: "pale", role: "status" });
    this.element = h("div", { class: "group", hidden: true }, this.list, h("div", { class: "row" }, this.text, this.taker));
    /** @type {Row | null} */
    this.chosen = null;
  }

  /** @param {Row[]} rows none where there was no sweep @param {string} folder of their files @param {string} shown path of the picture that is shown */
  renew(rows, folder, shown) {
    this.element.hidden = rows.length === 0;
    this.chosen = null;
    fill(this.list, ...rows.map((row) => {
      const path = `${folder}/${row.file}`;
      const place = h("button", { type: "button", onclick: told(async () => { this.press(place, row); await this.show(path); }) },
        h("img", { src: fileUrl(path), alt: "" }), h("span", {}, settingText(row)));
      if (path === shown) this.press(place, row);
      return place;
    }));
  }

  /** @param {HTMLElement} place @param {Row} row */
  press(place, row) {
    this.chosen = row;
    for (const each of place.parentElement?.children ?? [place]) each.setAttribute("aria-pressed", String(each === place));
    place.setAttribute("aria-pressed", "true");
    this.text.textContent = `${settingText(row)} · τ ${number(row.tau, 2)}`;
  }
}
