// @ts-check
/** Which camera is looked through, and with which PSF. */

import { post, studio } from "./api.js";
import { button, field, fill, group, h, setOptions } from "./dom.js";
import { live } from "./live.js";
import { told } from "./notices.js";
import { fieldPsfChoices, psfChoices } from "./choices.js";

export class SourceControls {
  constructor() {
    this.select = h("select", { onchange: () => this.ask() });
    this.folder = h("input", { type: "text", placeholder: "work/uploads", spellcheck: false });
    this.folderField = field("Folder to watch", this.folder);
    this.device = h("input", { type: "text", spellcheck: false });
    this.deviceField = field("Which one", this.device);
    this.psf = h("select", {});
    this.psfField = field("PSF", this.psf);
    this.starter = button("Start", told(() => this.start()), { "aria-label": "Start this camera" });
    this.why = h("ul", { class: "files pale" });
    this.missing = h("details", { hidden: true }, h("summary", {}, "Cameras that are not here"), this.why);
    this.element = group("Camera", h("div", { class: "row low" }, h("div", { class: "grow" }, field("Source", this.select)), this.starter),
      this.folderField, this.deviceField, this.psfField, this.missing);
    /** @type {any[]} */
    this.sources = [];
    this.listed = false;
    this.ask();
  }

  /** @param {any} state */
  follow(state) {
    if (this.listed) return;
    this.listed = true;
    told(() => this.list(state.source))();
  }

  /** @param {string | null} running */
  async list(running) {
    const { sources, folders } = await studio();
    this.sources = sources;
    setOptions(this.select, sources.map((/** @type {any} */ each) =>
      ({ value: each.id, label: each.label, disabled: !each.available })));
    const chosen = sources.find((/** @type {any} */ each) => running === each.id || running?.startsWith(`${each.id}:`));
    if (chosen) this.select.value = chosen.id;
    this.folder.placeholder = `${folders[0].id}/uploads`;
    fill(this.why, sources.filter((/** @type {any} */ each) => !each.available).map((/** @type {any} */ each) =>
      h("li", {}, `${each.label}: ${each.why}`)));
    this.missing.hidden = this.why.childElementCount === 0;
    setOptions(this.psf, [{ value: "", label: "None: the raw frames alone" }, ...await fieldPsfChoices(), ...await psfChoices()]);
    this.ask();
  }

  /** Show what the chosen source has to be told. */
  ask() {
    this.folderField.hidden = this.select.value !== "folder";
    const asks = this.sources.find((each) => each.id === this.select.value)?.asks;
    this.deviceField.hidden = !asks;
    this.device.placeholder = asks ?? "";
    this.psfField.hidden = this.select.value.startsWith("twin") || this.select.value === "";
  }

  async start() {
    const { value } = this.select;
    const named = value === "folder" ? this.folder.value.trim() || this.folder.placeholder
      : this.deviceField.hidden ? "" : this.device.value.trim();
    const source = named ? `${value}:${named}` : value;
    const psf = this.psfField.hidden ? null : this.psf.value || null;
    live.tell(await post("api/live/start", { source, psf }));
  }
}
