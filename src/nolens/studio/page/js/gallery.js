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
const FIRST = ["focused.png", "all-in-focus.png", "false-colour.png"];

/** @typedef {import("./choices.js").Entry} Entry */
/** @typedef {{name: string, changed: number, files: Files}} Result */
/** @typedef {{all: string[], picture: string, linear?: string, video?: string, cube?: string, stack?: string, record?: string}} Files paths of a result's files: of floats, of bands, of depths */

/** What the files of a result are, by their names; null where there is no picture. @param {string[]} all @returns {Files | null} */
export function filesOf(all) {
  const of = (/** @type {string} */ end) => all.find((path) => path.endsWith(end));
  const picture = FIRST.map((name) => of(`/${name}`)).find((path) => path) ?? all.find((path) => PICTURE.test(path));
  if (!picture) return null;
  return { all, picture, linear: of(picture.replace(PICTURE, ".tif")), video: of(".mp4"), cube: of("/cube.ome.tif"), stack: of("/sweep.html"), record: of(".json") };
}

/** A result of some files. @param {Entry} entry its picture or folder @param {Entry[]} files @returns {Result | null} */
function resultOf({ name, changed }, files) {
  const found = filesOf(files.map(({ path }) => path));
  return found && { name, changed, files: found };
}

/** The result of a picture, a sequence, or a stack. @param {Entry} entry @param {Entry[]} beside @returns {Promise<Result | null>} */
async function resultOfEntry(entry, beside) {
  const stem = entry.path.replace(PICTURE, "");
  const alike = beside.filter(({ path }) => path.startsWith(`${stem}.`));
  if (entry.kind === "folder") return resultOf(entry, [...await list(entry.path), ...alike]);
  return PICTURE.test(entry.name) ? resultOf(entry, alike) : null;
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
    const found = await Promise.all(own.flatMap(({ files }) => files.map((entry) => resultOfEntry(entry, files))));
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
      h("img", { src: fileUrl(result.files.picture), alt: "", loading: "lazy", decoding: "async" }),
      h("b", {}, result.name), h("small", {}, date(1000 * result.changed)), figures));
    if (!result.files.record) return;
    try {
      figures.textContent = mainFigures(await recordOf(result.files.record));
    } catch {
      figures.textContent = "Its record cannot be read";
    }
  }
}
