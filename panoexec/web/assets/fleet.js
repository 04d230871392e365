/* All vehicles of the broker, sorted by who needs somebody. */
import { el, isNumber, percent, svg } from "/assets/pages/elements.js";
import { STANDINGS, clock, headline, urgency } from "./model.js";
import { progressBar, redraw } from "./render.js";

const LETTERS = { d: "done", r: "retaken", c: "current", a: "again", m: "missing", t: "todo" };

export class FleetView {
  constructor(page) {
    this.page = page;
    this.title = "Vehicles";
    this.list = el("ul", { class: "cards", id: "vehicles" });
    this.empty = el("p", { class: "card empty" });
    this.node = el("div", { class: "column" }, el("h1", {}, "Vehicles"), this.empty, this.list);
    this.cards = new Map();
    this.update(new Set());
  }
  update() {
    const { model } = this.page, all = [...model.vehicles.values()].map((one) => ({ ...one, rank: urgency(one) })).sort((a, b) => a.rank - b.rank || (a.id < b.id ? -1 : 1));
    this.empty.hidden = all.length > 0;
    this.empty.textContent = model.link.up ? "No vehicle was heard yet. A vehicle appears here when its daemon is connected to the broker." : `No connection to the broker${model.link.reason ? `: ${model.link.reason}` : ""}.`;
    for (const [id, node] of this.cards) if (!model.vehicles.has(id)) { node.remove(); this.cards.delete(id); }
    all.forEach((one, place) => {
      let item = this.cards.get(one.id);
      if (!item) {
        item = el("li", {}, el("a", { class: "card", href: `/v/${one.id}`, "data-nav": `/v/${one.id}`, "data-vehicle": one.id }));
        this.cards.set(one.id, item);
      }
      if (this.list.children[place] !== item) this.list.insertBefore(item, this.list.children[place] || null);
      this.fill(item.firstChild, one);
    });
  }
  fill(node, one) {
    const state = one.state || {}, head = headline(one, this.page.model.link), counted = unfold(state.shots || "");
    node.className = `card ${head.kind}`;
    redraw(node, [head, state.name, state.shots, Math.round(state.eta_s || 0), Math.round(100 * (state.battery_frac || 0)), state.battery_need_frac], () => [
      el("div", { class: "with-mini" }, miniature(counted), el("div", {}, el("h2", {}, one.id), el("div", { class: "word" }, head.word), state.name ? el("p", { class: "line" }, state.name) : null)),
      counted.total ? progressBar(counted, STANDINGS) : null,
      el("p", { class: "line" }, [counted.total ? `${state.shots_done} of ${state.shots_total}` : null, isNumber(state.eta_s) ? `${clock(state.eta_s)} min left` : null, isNumber(state.battery_frac) ? `battery ${percent(state.battery_frac, 0)}${isNumber(state.battery_need_frac) ? `, needs ${percent(state.battery_need_frac, 0)}` : ""}` : null].filter(Boolean).join(" · ")),
      head.reason ? el("p", { class: "line why" }, head.reason) : null,
    ]);
  }
}
function unfold(text) {
  const counted = Object.fromEntries(Object.keys(STANDINGS).map((key) => [key, 0]));
  for (const run of text.matchAll(/([tcdram])(\d+)/g)) counted[LETTERS[run[1]]] += Number(run[2]);
  return { ...counted, total: Object.values(counted).reduce((sum, n) => sum + n, 0) };
}
/* A sphere in small: its ring is the progress. */
function miniature(counted) {
  const ring = 2 * Math.PI * 40;
  let at = 0;
  return svg("svg", { class: "mini", viewBox: "0 0 100 100", "aria-hidden": "true" },
    svg("circle", { cx: 50, cy: 50, r: 31, fill: "var(--c1)" }), svg("path", { d: "M19 50H81M50 19C30 35 30 65 50 81M50 19C70 35 70 65 50 81", fill: "none", stroke: "var(--muted)", "stroke-width": 1.5, opacity: 0.6 }),
    svg("circle", { cx: 50, cy: 50, r: 40, fill: "none", stroke: "var(--line)", "stroke-width": 9 }),
    Object.entries(STANDINGS).filter(([key]) => key !== "todo" && counted[key]).map(([key, [, name]]) => {
      const share = counted[key] / counted.total, arc = svg("circle", { cx: 50, cy: 50, r: 40, fill: "none", stroke: `var(--${name})`, "stroke-width": 9, "stroke-dasharray": `${share * ring} ${ring}`, transform: `rotate(${360 * at - 90} 50 50)` });
      at += share;
      return arc;
    }));
}
