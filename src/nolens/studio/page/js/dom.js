// @ts-check
/** Building elements, and the few controls that all panels share. */

/** @typedef {Node | string | number | null | undefined | false} Child */

let counted = 0;

/** An id that no other element has. */
export const freshId = (/** @type {string} */ stem) => `${stem}-${++counted}`;

/**
 * An element with its properties, listeners ("onclick") and children.
 *
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, any>} [given] class, for, aria-… and data-… as attributes, others as properties
 * @param {...(Child | Child[])} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function h(tag, given = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(given)) {
    if (value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && !name.includes("-")) /** @type {any} */ (element)[name] = value;
    else element.setAttribute(name, String(value));
  }
  element.append(...inner(children));
  return element;
}

/**
 * An SVG element with its attributes and children.
 *
 * @template {keyof SVGElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, string | number>} [attributes]
 * @param {...(Child | Child[])} children
 * @returns {SVGElementTagNameMap[T]}
 */
export function svg(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...inner(children));
  return element;
}

/** @param {(Child | Child[])[]} children @returns {(Node | string)[]} */
function inner(children) {
  return children
    .flat()
    .filter((each) => each !== null && each !== undefined && each !== false)
    .map((each) => (each instanceof Node ? each : String(each)));
}

/** Replace what an element holds. @param {Element} element @param {...(Child | Child[])} children */
export function fill(element, ...children) {
  element.replaceChildren(...inner(children));
}

/** A titled group of controls. @param {string} title @param {...(Child | Child[])} children */
export function group(title, ...children) {
  const id = freshId("group");
  return h("section", { class: "group", "aria-labelledby": id }, h("h2", { id }, title), ...children);
}

/** A control under its label. @param {string} label @param {HTMLElement} control */
export function field(label, control) {
  control.id ||= freshId("field");
  return h("div", { class: "field" }, h("label", { htmlFor: control.id }, label), control);
}

/**
 * A button that lets a person choose files of theirs.
 *
 * @param {string} text
 * @param {(files: File[]) => void} chosen
 * @param {Record<string, any>} [more] properties of the input
 */
export function filePicker(text, chosen, more = {}) {
  const input = h("input", { type: "file", class: "unseen", ...more, onchange: () => {
    const files = [...(input.files ?? [])];
    input.value = ""; // The same file can be chosen again.
    if (files.length) chosen(files);
  } });
  return h("label", { class: "button" }, text, input);
}

/** A box to tick with its label. @param {string} label @param {boolean} on @param {(on: boolean) => void} [changed] */
export function tick(label, on, changed = () => {}) {
  const box = h("input", {
    type: "checkbox", checked: on, id: freshId("tick"),
    onchange: () => changed(box.checked),
  });
  return { box, element: h("label", { class: "tick", htmlFor: box.id }, box, label) };
}

/** @param {string} text @param {() => void} clicked @param {Record<string, any>} [more] */
export const button = (text, clicked, more = {}) =>
  h("button", { type: "button", onclick: clicked, ...more }, text);

/**
 * A slider with its label and value; logarithmic where both ends are above zero and `log` is set.
 *
 * @param {{label: string, min: number, max: number, value: number, log?: boolean, step?: number,
 *   text: (value: number) => string, input?: (value: number) => void, change?: () => void}} given `change`: when it is let go
 */
export function slider(given) {
  let { min, max } = given;
  const steps = 400;
  const id = freshId("slider");
  const onto = (/** @type {number} */ value) =>
    given.log ? (steps * Math.log(value / min)) / Math.log(max / min) : value;
  const from = (/** @type {number} */ place) =>
    given.log ? min * (max / min) ** (place / steps) : place;
  const output = h("output", { htmlFor: id });
  const input = h("input", { type: "range", id });
  const range = () => {
    input.min = String(given.log ? 0 : min);
    input.max = String(given.log ? steps : max);
    input.step = given.log ? "1" : String(given.step ?? "any");
  };
  const tell = (/** @type {number} */ value) => {
    output.textContent = given.text(value);
    input.setAttribute("aria-valuetext", output.textContent);
  };
  const set = (/** @type {number} */ value) => {
    input.value = String(onto(Math.min(max, Math.max(min, value))));
    tell(value);
  };
  input.addEventListener("input", () => {
    const value = from(Number(input.value));
    tell(value);
    given.input?.(value);
  });
  input.addEventListener("change", () => given.change?.());
  range();
  set(given.value);
  return {
    input,
    element: h("div", { class: "slider" }, h("label", { htmlFor: id }, given.label), output, input),
    set,
    value: () => from(Number(input.value)),
    /** Other ends. @param {number} low @param {number} high */
    limit(low, high) {
      const value = from(Number(input.value));
      [min, max] = [low, high];
      range();
      set(value);
    },
  };
}

/**
 * Buttons of which one is pressed.
 *
 * @template {string} K
 * @param {string} label
 * @param {[K, string][]} choices
 * @param {K} chosen
 * @param {(chosen: K) => void} changed
 */
export function segments(label, choices, chosen, changed) {
  /** @type {Map<K, HTMLButtonElement>} */
  const buttons = new Map();
  const set = (/** @type {K} */ key) => {
    chosen = key;
    for (const [each, element] of buttons) element.setAttribute("aria-pressed", String(each === key));
  };
  for (const [key, text] of choices) {
    buttons.set(key, button(text, () => { set(key); changed(key); }));
  }
  set(chosen);
  const element = h("div", { class: "segments", role: "group", "aria-label": label }, ...buttons.values());
  return { element, set, value: () => chosen };
}

/** Options of a select. @param {HTMLSelectElement} select @param {{value: string, label: string, disabled?: boolean}[]} options */
export function setOptions(select, options) {
  const before = select.value;
  fill(select, ...options.map((each) =>
    h("option", { value: each.value, disabled: each.disabled ?? false }, each.label)));
  if (options.some((each) => each.value === before && !each.disabled)) select.value = before;
}

/** Rows of figures: [name, value]. @param {[string, Child][]} rows @param {string} [caption] */
export function figureTable(rows, caption) {
  return h("table", { class: "figures" },
    caption ? h("caption", { class: "unseen" }, caption) : null,
    h("tbody", {}, rows.map(([name, value]) =>
      h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, value)))));
}
