// @ts-check
/** The spectrum, or the polarisation, at a place of a picture of bands: a click chooses it. */

import { figureTable, fill, group, h } from "./dom.js";
import { number } from "./format.js";
import { told } from "./notices.js";
import { curve, noCurve } from "./plots.js";

export class Spectrum {
  /** @param {import("./viewer.js").Viewer} viewer of the picture */
  constructor(viewer) {
    this.viewer = viewer;
    /** @type {import("./pixels.js").LazyValues | null} of the bands */
    this.bands = null;
    this.mark = h("span", { class: "focus-mark", hidden: true });
    viewer.plane.append(this.mark);
    this.said = h("p", { class: "pale", role: "status" });
    this.shown = h("div", { class: "spectrum" });
    this.element = group("Spectrum, or polarisation", this.said, this.shown);
    this.open(null);
    viewer.frame.addEventListener("click", told((event) => this.click(event)));
  }

  /** Let the values of a picture be asked for; null where it has no bands. @param {import("./pixels.js").LazyValues | null} bands */
  open(bands) {
    this.bands = bands;
    this.element.hidden = !bands;
    this.mark.hidden = true;
    this.said.textContent = "Click on the picture.";
    fill(this.shown, noCurve());
  }

  /** @param {MouseEvent} event */
  async click(event) {
    const { bands, viewer } = this;
    const [across, down] = viewer.place(event.clientX, event.clientY);
    if (!bands || viewer.tool || across < 0 || across >= 1 || down < 0 || down >= 1) return;
    Object.assign(this.mark.style, { left: `${100 * across}%`, top: `${100 * down}%` });
    this.mark.hidden = false;
    const cube = await bands.get();
    if (bands !== this.bands) return;
    const { x, y, values } = cube.of(across, down);
    const { channels } = cube.head;
    this.said.textContent = `Row ${y}, column ${x}`;
    fill(this.shown, channels.every((name) => name.endsWith("nm"))
      ? curve({ x: channels.map(parseFloat), y: values.map((each) => each / cube.most), xLabel: "wavelength, nm", yLabel: "of the brightest", title: `Spectrum at row ${y}, column ${x}`, from: 0 })
      : figureTable(channels.map((name, place) => [name, number(values[place])]), `Polarisation at row ${y}, column ${x}`));
  }
}
