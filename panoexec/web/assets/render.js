/* Redraws what changed, and keeps the focus where it was. */
import { el } from "/assets/pages/elements.js";

const signatures = new WeakMap();

/* Rebuilds the holder's content if the signature is another one; what has the focus is found again by its data-key. */
export function redraw(holder, signature, build) {
  const text = JSON.stringify(signature);
  if (signatures.get(holder) === text) return false;
  signatures.set(holder, text);
  const focus = holder.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  const scroll = holder.scrollTop;
  holder.replaceChildren(...[build()].flat(Infinity).filter((node) => node !== null && node !== undefined && node !== false));
  holder.scrollTop = scroll;
  if (focus) holder.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus({ preventScroll: true });
  return true;
}
/* A button that stays reachable when it cannot be used, so that its reason is read. */
export function button(text, { key, reason = "", onclick, ...more }) {
  return el("button", {
    "data-key": key, "aria-disabled": reason ? "true" : null, title: reason || null, "aria-describedby": null,
    onclick: (event) => { if (reason) { event.preventDefault(); more.refused?.(reason); } else onclick(event); },
    ...Object.fromEntries(Object.entries(more).filter(([name]) => name !== "refused")),
  }, text);
}
export function timeOf(stamp) {
  const date = new Date(stamp);
  return Number.isNaN(date.getTime()) ? "" : date.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
}
export function dateOf(stamp) {
  const date = new Date(stamp);
  if (Number.isNaN(date.getTime())) return "";
  const here = date.toLocaleString([], { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", hour12: false });
  return date.getTimezoneOffset() === 0 ? `${here} UTC` : `${here} (${date.toISOString().slice(11, 16)} UTC)`;
}
export const figure = (name, value, unit = "", kind = "") => el("div", { class: `figure ${kind}` }, el("div", { class: "value" }, value, unit ? el("small", {}, ` ${unit}`) : null), el("div", { class: "name" }, name));

const rounded = (value) => `${Math.round(1000 * value) / 10}%`;
/* The bar in the colours of the map, and its legend with numbers. */
export function progressBar(counted, standings) {
  const shown = Object.entries(standings).filter(([key]) => counted[key] > 0);
  const label = shown.map(([key, [word]]) => `${counted[key]} ${word}`).join(", ");
  return el("div", { class: "bar", role: "img", "aria-label": `Shots: ${label || "none"}` }, shown.map(([key, [, name]]) => el("i", { class: key, style: { width: rounded(counted[key] / counted.total), "--swatch": `var(--${name})` } })));
}
export function legend(counted, standings, more = "") {
  return el("ul", { class: "legend" }, Object.entries(standings).filter(([key]) => counted[key] > 0).map(([key, [word, name, dash]]) => el("li", { class: dash.length ? "dashed" : "", style: { "--swatch": `var(--${name})` } }, `${counted[key]} ${word}`)), more ? el("li", { class: "more" }, more) : null);
}
