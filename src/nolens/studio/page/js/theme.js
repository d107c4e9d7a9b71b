// Before the first paint, so that a kept choice does not flash: that is why this is no module.
"use strict";
(() => {
  try {
    const kept = localStorage.getItem("nolens-theme");
    if (kept === "dark" || kept === "light") document.documentElement.dataset.theme = kept;
  } catch {
    // Without storage the system's choice holds.
  }
})();
