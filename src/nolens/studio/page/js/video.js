// @ts-check
/** A video that plays where pictures are shown. */

import { fileUrl } from "./api.js";
import { fill, h } from "./dom.js";
import { baseName } from "./format.js";
import { Viewer } from "./viewer.js";

export class Video {
  /** @param {() => void} refused is called where the browser cannot play it */
  constructor(refused) {
    this.video = h("video", { controls: true, loop: true, onloadedmetadata: () => this.lay(), onerror: refused });
    this.note = h("span", {});
    this.viewer = new Viewer({ title: "Video", layers: [this.video], note: this.note });
    this.others = h("div", {});
    this.element = h("div", { class: "stage", hidden: true }, this.viewer.element, this.others);
  }

  /** @param {string} path @param {string} note beside its name @param {HTMLElement} others links to other forms of it */
  open(path, note, others) {
    this.video.src = fileUrl(path);
    this.note.textContent = note;
    fill(this.others, h("details", {}, h("summary", {}, "Files"), others));
    this.viewer.renew(baseName(path), { at: () => "" });
  }

  /** The viewer takes the size of a video from its attributes, which it does not have by itself. */
  lay() {
    [this.video.width, this.video.height] = [this.video.videoWidth, this.video.videoHeight];
    this.viewer.lay();
  }
}
