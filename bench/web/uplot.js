// uPlot is a classic script of the page, unchanged as it was released (see uplot/README.md); this gives it to the modules.

/** @type {any} */
export const uPlot = Reflect.get(globalThis, "uPlot");
if (!uPlot) throw new Error("uplot/uPlot.iife.min.js was not loaded");
