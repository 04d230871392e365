/* Elements with text only (never markup), number formats and redrawing: shared by the report and the operator's page. */
"use strict";
const SVG = "http://www.w3.org/2000/svg";

/* An element with attributes and children; strings become text, never markup. */
export function el(name, attributes = {}, ...children) {
  return furnish(document.createElement(name), attributes, children);
}
export function svg(name, attributes = {}, ...children) {
  return furnish(document.createElementNS(SVG, name), attributes, children);
}
export function furnish(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "style") for (const [name, text] of Object.entries(value)) node.style.setProperty(name, text);
    else node.setAttribute(key, value === true ? "" : String(value));
  }
  node.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

export const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
export const minus = (text) => text.replace("-", "\u2212");
export const degrees = (value, digits = 2) => (isNumber(value) ? minus((Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits)) + "°" : "–");
export const signed = (value, digits = 3) => (isNumber(value) ? (value < 0 ? "\u2212" : "+") + Math.abs(value).toFixed(digits) + "°" : "–");
/* Values below 1 are never rounded to 100 %. */
export function percent(fraction, digits = 1) {
  if (!isNumber(fraction)) return "–";
  let shown = digits;
  while (fraction < 1 && Number((100 * fraction).toFixed(shown)) >= 100 && shown < 9) shown += 1;
  return `${(100 * fraction).toFixed(shown)} %`;
}
export function seconds(value) {
  if (!isNumber(value)) return "–";
  if (value < 100) return `${value.toFixed(1)} s`;
  const whole = Math.round(value), hours = Math.floor(whole / 3600), rest = whole % 3600;
  const clock = `${Math.floor(rest / 60)}:${String(rest % 60).padStart(2, "0")}`;
  return hours ? `${hours}:${clock.padStart(5, "0")} h` : `${clock} min`;
}
/* A moment in UTC, as files name it, and beside it as the clock of who reads shows it. */
export function when(stamp) {
  if (!stamp) return null;
  const utc = stamp.replace("T", " ").replace(/\.\d+/, "").replace("Z", " UTC");
  const date = new Date(stamp);
  if (Number.isNaN(date.getTime()) || date.getTimezoneOffset() === 0) return utc;
  return `${utc} (${date.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" })} local)`;
}
export const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
export function rgb(name) {
  const hex = colour(name).replace("#", "");
  return [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16));
}
/* Draws now and after each change of width or colour scheme. */
export function responsive(node, draw) {
  let width = 0;
  const again = () => { if (node.clientWidth && node.clientWidth !== width) { width = node.clientWidth; draw(width); } };
  new ResizeObserver(() => requestAnimationFrame(again)).observe(node);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw(width || node.clientWidth));
  again();
}
