// @ts-check
/** The gallery: all results with their thumbnails, dates and main figures, the newest first. */

import { fileUrl, list } from "./api.js";
import { filesBy } from "./choices.js";
import { button, fill, h } from "./dom.js";
import { date, mainFigures, recordOf } from "./record.js";
import { told } from "./notices.js";

const AT_ONCE = 24;
const PICTURE = /\.png$/i;
/** Pictures of a folder that stand for it. */
export const FIRST = ["focused.png", "all-in-focus.png", "false-colour.png"];

/** @typedef {import("./choices.js").Entry} Entry */
/** @typedef {{name: string, picture: string, linear: string | null, record: string | null, changed: number}} Result paths of its files */

/** @param {Entry[]} entries @param {string} path */
const there = (entries, path) => (entries.some((each) => each.path === path) ? path : null);

/** The result of a picture, among the files beside it. @param {Entry} entry @param {Entry[]} beside @returns {Result} */
function resultOf(entry, beside) {
  const stem = entry.path.replace(PICTURE, "");
  return { name: entry.name, picture: entry.path, changed: entry.changed, linear: there(beside, `${stem}.tif`), record: there(beside, `${stem}.json`) };
}

/** The result of a folder: a sequence or a focal stack. @param {Entry} folder @param {Entry[]} beside @returns {Promise<Result | null>} */
async function folderResult(folder, beside) {
  const files = await list(folder.path);
  const pictures = files.filter(({ name }) => PICTURE.test(name));
  const first = pictures.find(({ name }) => FIRST.includes(name)) ?? pictures[0];
  if (!first) return null;
  const record = files.find(({ kind }) => kind === "record")?.path ?? there(beside, `${folder.path}.json`);
  return { ...resultOf(first, files), name: folder.name, changed: folder.changed, record };
}

export class Gallery {
  /** @param {(result: Result) => Promise<void>} open shows one */
  constructor(open) {
    this.open = open;
    this.cards = h("div", { class: "gallery" });
    this.more = button("Show older ones", told(() => this.add()), { hidden: true });
    this.none = h("p", { class: "pale" }, "No results yet: reconstruct a picture, or save one on the Viewfinder (key s).");
    this.element = h("div", { class: "stage", hidden: true }, this.none, this.cards, h("div", { class: "row" }, this.more));
    /** @type {Result[]} that are not shown yet */
    this.rest = [];
  }

  async refresh() {
    const groups = await filesBy(() => true, ["pictures", "shots"]);
    const own = groups.filter(({ place }) => /\/(pictures|shots)$/.test(place));
    const found = await Promise.all(own.flatMap(({ files }) => files.map((entry) =>
      (entry.kind === "folder" ? folderResult(entry, files) : PICTURE.test(entry.name) ? resultOf(entry, files) : null))));
    this.rest = found.filter((each) => each !== null).sort((one, other) => other.changed - one.changed);
    this.none.hidden = this.rest.length > 0;
    fill(this.cards);
    await this.add();
  }

  /** Show some more. */
  async add() {
    const some = this.rest.splice(0, AT_ONCE);
    this.more.hidden = this.rest.length === 0;
    await Promise.all(some.map((result) => this.card(result)));
  }

  /** @param {Result} result */
  async card(result) {
    const figures = h("small", {});
    this.cards.append(h("button", { type: "button", class: "card", onclick: told(() => this.open(result)) },
      h("img", { src: fileUrl(result.picture), alt: "", loading: "lazy", decoding: "async" }),
      h("b", {}, result.name), h("small", {}, date(1000 * result.changed)), figures));
    if (!result.record) return;
    try {
      figures.textContent = mainFigures(await recordOf(result.record));
    } catch {
      figures.textContent = "Its record cannot be read";
    }
  }
}
