/* One vehicle, live: state, progress, map, actions, the selected shot, what happened. */
import { degrees, el, isNumber, percent, plural, signed, svg, when } from "/assets/pages/elements.js";
import { actions, entryText, shotActions, stageText } from "./actions.js";
import { ask, toast } from "./dialogs.js";
import { STANDINGS, acceptedOf, advice, clock, counts, headline, light, standing } from "./model.js";
import { button, figure, legend, progressBar, redraw, timeOf } from "./render.js";
import { mapCard } from "./shotmap.js";

const AXES = ["pitch", "roll", "yaw"];
const MARKS = { info: "·", good: "✓", warning: "!", bad: "✗" };
const KINDS = { info: "", good: "good", warning: "warn", bad: "bad" };

export class VehicleView {
  /* page: {model, link, go}. */
  constructor(page, vehicle) {
    Object.assign(this, { page, vehicle, chosen: null, sent: null });
    const { map, toolbar, node } = mapCard("Map of the sphere with the footprint of every shot. Arrow keys turn it, plus and minus zoom; j and k select a shot.", { picked: (shot) => this.choose(shot && (shot.i === this.chosen ? null : shot.i)) });
    this.map = map;
    const part = (tag, name, label, ...rest) => el(tag, { class: `card ${name}`, "aria-label": label }, ...rest);
    this.parts = {
      state: part("section", "state", "State"), progress: part("section", "progress", "Progress"), actions: el("div", { class: "actions" }),
      shot: part("section", "shot", "Selected shot"), aim: part("section", "", "Pointing"), log: el("ol", { class: "log", tabindex: 0, "aria-label": "Events, newest first" }),
      told: el("p", { class: "muted small" }),
    };
    this.parts.shot.setAttribute("aria-live", "polite");
    this.toolbar = toolbar;
    const mapSection = part("section", "", "Map", toolbar, node, this.parts.told);
    const actionsSection = el("section", { class: "card actions-card", "aria-label": "Actions" }, this.parts.actions);
    const logSection = part("section", "", "What happened", el("h2", {}, "What happened"), this.parts.log);
    this.node = el("div", { class: "grid two" }, el("div", { class: "wide column" }, this.parts.state, this.parts.progress),
      mapSection, el("div", { class: "column" }, actionsSection, this.parts.aim, this.parts.shot, logSection));
    this.update(new Set(["vehicle"]));
  }
  get data() {
    const { vehicle } = this.page.model;
    return vehicle && vehicle.id === this.vehicle ? vehicle : null;
  }
  get role() { return this.page.model.hello ? this.page.model.hello.role : "viewer"; }
  get title() { return this.data && this.data.state && this.data.state.name ? `${this.data.state.name} · ${this.vehicle}` : this.vehicle; }
  update(changed) {
    const { data } = this, { model } = this.page;
    if (!data) { redraw(this.parts.state, ["none"], () => el("p", {}, "Asking the vehicle …")); return; }
    this.drawState(data, model);
    this.drawProgress(data);
    this.drawActions(data, model);
    this.drawShot(data, model);
    this.drawAim(data);
    this.drawLog(data);
    if (["vehicle", "mission", "shot", "state"].some((name) => changed.has(name))) this.map.take(data);
    const n = data.mission ? data.mission.shots.length : 0;
    redraw(this.parts.told, [n, data.mission && data.mission.gap], () => [n ? "Tap a footprint for its photo." : "No mission: plan one.", data.mission && data.mission.gap ? " This server missed a part of what happened; the states of the shots are complete." : ""]);
  }
  drawState(data, model) {
    const head = headline(data, model.link), links = (data.state && data.state.link) || {}, hint = advice(data);
    const lights = Object.keys(links).map((name) => ({ name, ...light(name, links[name]) }));
    const silent = data.status !== "offline" && isNumber(data.silent_s) && data.silent_s > 40 ? `Nothing was heard from the vehicle for ${Math.round(data.silent_s)} s.` : "";
    const broker = model.link.up ? "" : `The server has no connection to the broker${model.link.reason ? `: ${model.link.reason}` : ""}.`;
    this.parts.state.className = `card state ${head.kind}`;
    redraw(this.parts.state, [head, lights.map((one) => [one.name, one.ok]), silent, broker, hint, data.state && data.state.name], () => [
      el("div", {}, el("h1", {}, (data.state && data.state.name) || this.vehicle, data.state && data.state.name ? el("span", { class: "muted" }, ` · ${this.vehicle}`) : null), el("div", { class: "word", id: "state-word" }, head.word)),
      el("div", { class: "lights", role: "group", "aria-label": "Links" }, lights.map((one) => el("button", { class: `light ${one.ok ? "" : "off"}`, "data-key": `light-${one.name}`, "aria-label": `${one.name} ${one.ok ? "connected" : "lost"}: tell more`, onclick: () => toast(`light-${one.name}`, light(one.name, ((this.data.state || {}).link || {})[one.name]).text, one.ok ? "" : "bad") }, el("i", {}), one.ok ? one.name : `${one.name} lost`))),
      [broker, silent, head.reason].filter(Boolean).map((text) => el("p", { class: "reason" }, text)),
      hint ? el("p", { class: "advice" }, el("b", {}, "What to do: "), hint) : null,
    ]);
  }
  drawProgress(data) {
    const state = data.state || {}, counted = counts(data), need = state.battery_need_frac;
    const short = isNumber(need) && isNumber(state.battery_frac) && state.battery_frac < need;
    const content = Object.entries(state.content || {}).map(([name, n]) => `${n} ${name.replaceAll("_", " ")}`).join(", ");
    redraw(this.parts.progress, [counted, state.shots_done, state.shots_total, state.retakes, Math.round(state.eta_s || 0), Math.round(100 * (state.battery_frac || 0)), need, content], () => [
      el("div", { class: "figures" },
        figure("shots", String(state.shots_done || 0), `of ${state.shots_total || 0}`), figure("retakes", String(state.retakes || 0)),
        figure("left", isNumber(state.eta_s) ? clock(state.eta_s) : "–", isNumber(state.eta_s) ? "min" : ""),
        figure(isNumber(need) ? `battery, needs ${percent(need, 0)}` : "battery", isNumber(state.battery_frac) ? percent(state.battery_frac, 0) : "–", "", short ? "alarm" : "")),
      counted.total ? progressBar(counted, STANDINGS) : null, counted.total ? legend(counted, STANDINGS, content ? `content: ${content}` : "") : null,
      short ? el("p", { class: "reason" }, "The battery may not last to the end of the mission.") : null,
    ]);
  }
  drawActions(data, model) {
    const set = actions(data, this.role, model.lostSince !== null);
    this.set = set;
    const newest = data.log.length ? data.log[data.log.length - 1] : null;
    const signature = [set, newest];
    redraw(this.parts.actions, signature, () => {
      const make = (one, look) => button(one.label, { key: one.command, id: `do-${one.command}`, class: look, reason: one.reason, onclick: () => this.act(one), refused: (why) => toast("why", `${one.label}: ${why}`) });
      const all = [set.primary, ...set.others, ...(set.abort ? [set.abort] : [])], greyed = all.filter((one) => one.reason);
      const kind = newest && (newest.stage === "done" ? "good" : ["refused", "failed"].includes(newest.stage) ? "bad" : "run");
      return [
        make(set.primary, "big solid primary"), set.others.map((one) => make(one, "big plain")), set.abort ? make(set.abort, "big outline-bad abort") : null,
        greyed.length ? el("p", { class: "why" }, greyed.map((one) => `${one.label}: ${one.reason}.`).join(" ")) : null,
        newest ? el("p", { class: `stage ${kind}`, role: "status", id: "stage" }, el("b", {}, stageText(newest)), el("span", {}, `${entryText(newest)} · ${newest.who || "somebody"} · ${timeOf(newest.time)}`)) : null,
      ];
    });
  }
  async act(one) {
    if (one.command === "open-plan") { this.page.go(`/v/${this.vehicle}#plan`); return; }
    if (one.command === "open-result") { this.page.go(this.page.model.hello?.missions ? `/v/${this.vehicle}#mission=${this.data.state.mission_id}` : `/v/${this.vehicle}#missions`); return; }
    if (one.question && !(await ask(one.question))) return;
    this.page.link.command(this.vehicle, one.command, one.fields);
    toast("command", `${one.label}: sent`);
  }
  choose(i) {
    this.chosen = i;
    this.map.chosen = i;
    const shown = i !== null && this.map.byIndex.get(i);
    if (shown && !this.map.place(shown.boresight, this.map.basis())) this.map.turnTo(shown.boresight);
    this.map.ask();
    if (this.data) this.drawShot(this.data, this.page.model);
  }
  drawShot(data, model) {
    const shot = this.chosen === null || !data.mission ? null : data.mission.shots.find((one) => one.i === this.chosen);
    if (!shot) { this.parts.shot.hidden = true; redraw(this.parts.shot, null, () => []); return; }
    this.parts.shot.hidden = false;
    const how = standing(data, shot), can = shotActions(data, shot, this.role, model.lostSince !== null);
    redraw(this.parts.shot, [shot, how, can], () => this.shotCard(data, shot, how, can));
  }
  shotCard(data, shot, how, can) {
    const taken = acceptedOf(shot), tau = data.mission.tolerance_deg || {}, last = taken || shot.attempts[shot.attempts.length - 1];
    const rows = [];
    if (shot.target) rows.push(["target", `pitch ${degrees(shot.target[0])}, yaw ${degrees(shot.target[1])}`]);
    if (last && last.error) AXES.forEach((axis, k) => rows.push([`${axis} error`, [`${signed(last.error[k])} of ±${tau[axis] ?? "–"}°`, tauBar(last.error[k], tau[axis])]]));
    const content = taken && taken.content;
    if (content) rows.push(["content", content.verdict.replaceAll("_", " ") + (content.reason ? `: ${content.reason}` : "")]);
    if (content && isNumber(content.sharpness)) rows.push(["sharpness", `${percent(content.sharpness, 0)} of its neighbours`]);
    if (content) rows.push(["ties", content.ties.length ? content.ties.map((tie) => `${tie.shot} (${plural(tie.points, "point")})`).join(", ") : "none"]);
    if (taken && taken.evidence) rows.push(["evidence", taken.evidence.replaceAll("_", " ")]);
    if (!taken && shot.reason) rows.push(["reason", shot.reason]);
    const others = shot.attempts.filter((one) => one !== taken);
    return [
      el("div", { class: "head" }, el("h2", { id: "shot-title" }, `Shot ${shot.i}${shot.patch ? ", a patch" : ""}`), el("span", { class: `pill ${{ done: "good", retaken: "warn", current: "run", missing: "bad", again: "warn", doubtful: "warn" }[how] || ""}` }, STANDINGS[how][0])),
      shot.url ? el("img", { src: shot.url, alt: `Photo of shot ${shot.i}`, decoding: "async" }) : null,
      el("div", { class: "row" }, can.map((one) => button(one.label, { key: one.command, id: `shot-${one.command}`, class: "big plain", reason: one.reason, onclick: () => this.act(one), refused: (why) => toast("why", `${one.label}: ${why}`) })), el("button", { class: "big plain", "data-key": "close", "aria-label": "Close the selected shot", onclick: () => this.choose(null) }, "Close")),
      can.some((one) => one.reason) ? el("p", { class: "muted small" }, can.filter((one) => one.reason).map((one) => `${one.label}: ${one.reason}.`).join(" ")) : null,
      el("table", {}, el("tbody", {}, rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, value))),
        others.map((one) => el("tr", {}, el("th", { scope: "row" }, `attempt ${one.n}`), el("td", {}, `${one.verdict}${one.reason ? `: ${one.reason}` : ""}`))))),
    ];
  }
  /* The error against τ as a target: of the camera now if the vehicle tells it, else of the last photo. */
  drawAim(data) {
    const pose = data.state && data.state.pose, tau = data.mission && data.mission.tolerance_deg;
    const current = data.state && data.state.current;
    let error = null, what = "";
    if (pose && pose.error_deg && AXES.every((axis) => isNumber(pose.error_deg[axis]))) { error = AXES.map((axis) => pose.error_deg[axis]); what = "camera now"; } else if (data.mission) {
      let last = null;
      for (const shot of data.mission.shots) for (const one of shot.attempts) if (one.error && (!last || one.time > last[1].time)) last = [shot, one];
      if (last) { error = last[1].error; what = `shot ${last[0].i}, when its photo was taken`; }
    }
    const known = Boolean(error && tau && AXES.every((axis) => isNumber(tau[axis]) && tau[axis] > 0));
    this.parts.aim.hidden = !known;
    // far outside the tolerance it is not wrong, but on its way
    const far = known && what === "camera now" && AXES.some((axis, k) => Math.abs(error[k]) > 5 * tau[axis]);
    redraw(this.parts.aim, [error, what, tau, far, current], () => (known ? aim(error, far ? `to ${isNumber(current) ? `shot ${current}` : "the next shot"}` : what, tau, far) : []));
  }
  drawLog(data) {
    const events = (data.mission ? data.mission.events : []).map((event) => ({ time: event.time, level: event.level, text: event.text, shot: event.shot, key: `e${event.seq}` }));
    const commands = data.log.map((entry) => ({ time: entry.time, level: entry.stage === "refused" || entry.stage === "failed" ? "bad" : "info", text: `${entry.who || "Somebody"}: ${entryText(entry)} – ${stageText(entry)}`, shot: null, key: `c${entry.id}` }));
    const lines = [...events, ...commands].map((line) => ({ ...line, at: Date.parse(line.time) || 0 })).sort((a, b) => b.at - a.at).slice(0, 120);
    redraw(this.parts.log, lines, () => (lines.length ? lines.map((line) => el("li", { class: KINDS[line.level] || "" }, el("time", { datetime: line.time, title: when(line.time) }, timeOf(line.time)), el("b", { "aria-label": line.level === "info" ? null : line.level }, MARKS[line.level] || "·"),
      el("span", {}, line.text))) : el("li", {}, el("span", { class: "muted" }, "Nothing yet."))));
  }
  /* Keys of this view; returns whether the key was one. */
  key(name) {
    const shots = this.data && this.data.mission ? this.data.mission.shots.map((shot) => shot.i) : [];
    const step = (by) => { if (shots.length) this.choose(this.chosen === null ? shots[by > 0 ? 0 : shots.length - 1] : shots[(shots.indexOf(this.chosen) + by + shots.length) % shots.length]); };
    const click = (id) => document.getElementById(id)?.click();
    const own = {
      j: () => step(1), k: () => step(-1), Escape: () => this.choose(null), r: () => click("shot-repeat"), s: () => click("shot-skip"), x: () => click("do-abort"), f: () => click("do-finish"),
      n: () => click("do-open-plan"), o: () => click("do-open-result"), p: () => (document.getElementById("do-pause") || document.getElementById("do-resume"))?.click(),
      m: () => this.toolbar.querySelector("button[data-view][aria-pressed=false]")?.click(),
    }[name];
    if (own) own();
    return Boolean(own);
  }
}

function tauBar(value, tau) {
  const share = Math.max(-1, Math.min(1, value / (tau || 1) / 1.5)), width = Math.max(1.5, 50 * Math.abs(share));
  return el("div", { class: "tau", "aria-hidden": "true" }, el("i", { class: Math.abs(value) > tau ? "over" : "", style: { left: `${share < 0 ? 50 - width : 50}%`, width: `${width}%` } }));
}
function aim(error, what, tau, far) {
  const share = AXES.map((axis, k) => error[k] / tau[axis]), out = share.some((one) => Math.abs(one) > 1);
  const clip = (x) => 50 + 32 * Math.max(-1.45, Math.min(1.45, x)), x = clip(share[2]), y = clip(-share[0]), roll = Math.max(-60, Math.min(60, 30 * share[1]));
  return [el("div", { class: `aim ${far ? "run" : out ? "bad" : "good"}` },
    svg("svg", { viewBox: "0 0 100 100", role: "img", "aria-label": `Pointing error, ${far ? "on the way to the target" : out ? "outside the tolerance" : "inside the tolerance"}` },
      svg("circle", { class: "ring", cx: 50, cy: 50, r: 32 }), svg("path", { class: "axis", d: "M50 4V96M4 50H96", fill: "none" }),
      svg("path", { class: "cross", d: "M-9 0H9M0 -9V9", fill: "none", transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${roll.toFixed(1)})` })),
    el("div", {}, el("h2", {}, far ? "On its way" : out ? "Outside τ" : "Inside τ"), el("p", { class: "muted small" }, what), el("div", {}, AXES.map((axis, k) => el("div", { class: "small" }, `${axis} ${signed(error[k])} of ±${tau[axis]}°`)))))];
}
