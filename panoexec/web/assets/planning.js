/* Planning: band and sector are dragged on the sphere; what is shown is what is started. */
import { colour, el, isNumber, minus, percent, plural } from "/assets/pages/elements.js";
import { azimuthOf, direction, elevationOf, levelMatrix, outlineOf } from "/assets/pages/sphere_math.js";
import { ask, toast } from "./dialogs.js";
import { certificateLine, draftOf, dragged, faults, fieldsOf, guess, handles, isCircle, missionOf, presetDraft, sameDraft, startReason } from "./draft.js";
import { clock } from "./model.js";
import { button, figure, redraw } from "./render.js";
import { mapCard } from "./shotmap.js";

const PAUSE_MS = 350;
const REACH_PX = 30;
const QUICK = [["Ground to +30°", [-90, 30]], ["Ground only", [-90, -10]], ["Horizon ±20°", [-20, 20]]];

export class PlanView {
  constructor(page, vehicle) {
    Object.assign(this, { page, vehicle, title: `Plan · ${vehicle}`, draft: null, answer: null, asking: null, known: null, started: null, problem: "", presets: [] });
    const { map, toolbar, node } = mapCard("Map of the planned footprints. The edges of the band have handles; numbers for them are beside the map. Arrow keys turn the map.", {
      id: "plan-ball", picked: () => {}, follow: false, grab: (d, at) => this.grab(at), layers: [() => this.drawBand()],
    });
    this.map = map;
    map.pitch = -12;
    map.followed = false;
    map.shaded = true;
    this.verdict = el("section", { class: "card", "aria-label": "What the plan costs", "aria-live": "polite" });
    this.form = el("section", { class: "card fields", "aria-label": "What to take" });
    this.act = el("section", { class: "card actions-card", "aria-label": "Start" });
    this.node = el("div", { class: "grid two" }, el("h1", { class: "wide" }, "Plan a mission"), el("section", { class: "card", "aria-label": "Map of the plan" }, toolbar, node, el("p", { class: "muted small" }, "Drag the round handles to set the band; drag the sphere to turn it.")),
      el("div", { class: "column" }, this.form, this.verdict, this.act));
    this.ask();
    this.presetsId = page.link.command(vehicle, "presets");
  }
  get data() { const { vehicle } = this.page.model; return vehicle && vehicle.id === this.vehicle ? vehicle : null; }
  close() { clearTimeout(this.timer); }
  /* Asks the vehicle for a plan of the draft; without a draft, for what its configuration says. */
  ask() {
    clearTimeout(this.timer);
    const fields = { ...(this.draft ? fieldsOf(this.draft) : {}), shots: true };
    this.asking = { id: this.page.link.command(this.vehicle, "plan", fields), draft: this.draft };
    this.draw();
  }
  change(draft, { later = true } = {}) {
    this.draft = draft;
    this.map.mosaic.ground({ elevation: draft.elevation, azimuth: draft.azimuth });
    clearTimeout(this.timer);
    if (!Object.keys(faults(draft)).length) this.timer = setTimeout(() => this.ask(), later ? PAUSE_MS : 0);
    this.fillNumbers();
    this.draw();
  }
  take(answer) {
    const { draft } = this.asking;
    if (!["done", "refused", "failed"].includes(answer.stage)) return;
    this.asking = null;
    if (answer.stage !== "done") {
      const code = answer.error && answer.error.code;
      if (code === "superseded") return;
      this.answer = { ok: false, draft: draft || this.draft, text: answer.error ? answer.error.message || String(answer.error.code || answer.error) : "the vehicle did not answer" };
      if (!draft && !this.draft) this.change({ camera: "", overlap: 0.15, elevation: [-90, 30], azimuth: [-180, 180] });
      return;
    }
    const { data } = answer;
    if (!data.plan) { this.answer = { ok: false, draft: draft || this.draft, text: "The plan is too large to be shown, so it cannot be started from here." }; return; }
    const shown = draft || draftOf(data.plan);
    if (!this.draft) { this.draft = shown; this.buildForm(); this.map.yaw = (data.plan.constraints.azimuth_deg[0] + data.plan.constraints.azimuth_deg[1]) / 2; }
    if (!sameDraft(shown, this.draft)) return;
    this.answer = { ok: true, draft: shown, ...data };
    this.known = { draft: shown, images: data.images, duration_s: data.duration_s || 0 };
    this.map.take({ mission: missionOf(data.plan), marks: "", state: null });
    this.map.mosaic.ground({ elevation: shown.elevation, azimuth: shown.azimuth });
  }
  update(changed) {
    if (this.asking) {
      const answer = this.page.model.answers.get(this.asking.id);
      if (answer) this.take(answer);
    }
    const presets = this.presetsId && this.page.model.answers.get(this.presetsId);
    if (presets && presets.stage === "done") {
      this.presetsId = null;
      this.presets = presets.data.presets;
      if (this.draft) this.buildForm();
    }
    if (this.started) {
      const answer = this.page.model.answers.get(this.started);
      if (answer && answer.stage === "done") { this.started = null; this.page.go(`/v/${this.vehicle}`); return; }
      if (answer && ["refused", "failed"].includes(answer.stage)) { this.started = null; this.problem = answer.error ? answer.error.message || answer.error.code : "no answer"; }
    }
    if (changed.has("hello") && this.draft) this.buildForm();
    this.draw();
  }
  buildForm() {
    const { model } = this.page, number = (key, label, value) => el("span", { class: "field" }, el("label", { for: `n-${key}` }, label), el("input", { type: "number", id: `n-${key}`, step: 1, inputmode: "numeric", value: String(value), oninput: () => this.typed() }));
    const cameras = [["", "as the vehicle is configured"], ...model.cameras.map((camera) => [camera.name, camera.name])];
    const name = this.form.querySelector("#n-name")?.value || "";
    this.circle = el("button", { class: "plain", id: "circle", onclick: () => this.toggleCircle() }, "Whole circle");
    this.slider = el("input", { type: "range", id: "n-overlap", min: 5, max: 80, step: 1, value: Math.round(100 * this.draft.overlap), oninput: () => this.typed() });
    this.sliderText = el("output", { for: "n-overlap" });
    this.select = el("select", { id: "n-camera", onchange: () => this.typed() }, cameras.map(([value, text]) => el("option", { value, selected: value === this.draft.camera }, text)));
    this.form.replaceChildren(
      el("div", { class: "chips", role: "group", "aria-label": "Quick choices" },
        this.presets.map((one) => el("button", { class: "preset", "aria-pressed": String(one.preset === this.draft.preset), "data-preset": one.preset, onclick: () => this.preset(one) }, one.name || one.preset)),
        QUICK.map(([text, band]) => el("button", { onclick: () => this.change({ ...this.draft, preset: "", ownOverlap: true, elevation: [...band], azimuth: [-180, 180] }) }, text))),
      el("div", { class: "field" }, el("label", { for: "n-name" }, "Name of the mission"), el("input", { type: "text", id: "n-name", maxlength: 80, value: name, placeholder: "for example: chapel, west side", autocomplete: "off" })),
      el("div", { class: "field" }, el("label", { for: "n-camera" }, "Camera"), this.select),
      el("div", { class: "field" }, el("div", { class: "row" }, el("label", { for: "n-overlap" }, "Overlap of neighbours"), this.sliderText), this.slider),
      el("div", { class: "pairs", role: "group", "aria-label": "Band, degrees above the horizon" }, number("low", "Lowest, °", this.draft.elevation[0]), number("high", "Highest, °", this.draft.elevation[1])),
      el("div", { class: "pairs", role: "group", "aria-label": "Sector, degrees clockwise" }, number("left", "From, °", this.draft.azimuth[0]), number("right", "clockwise to, °", this.draft.azimuth[1]), this.circle),
      this.fault = el("p", { class: "small bad-text", role: "alert", hidden: true }));
    this.fillNumbers();
  }
  fillNumbers() {
    if (!this.slider) return;
    const values = { low: this.draft.elevation[0], high: this.draft.elevation[1], left: this.draft.azimuth[0], right: this.draft.azimuth[1] }, wrong = faults(this.draft);
    for (const [key, value] of Object.entries(values)) {
      const field = this.form.querySelector(`#n-${key}`);
      if (document.activeElement !== field && Number.isFinite(value)) field.value = String(value);
      field.setAttribute("aria-invalid", String(Boolean(wrong[key])));
    }
    this.slider.value = String(Math.round(100 * this.draft.overlap));
    this.slider.setAttribute("aria-valuetext", percent(this.draft.overlap, 0));
    this.sliderText.textContent = percent(this.draft.overlap, 0);
    for (const chip of this.form.querySelectorAll(".preset")) chip.setAttribute("aria-pressed", String(chip.dataset.preset === this.draft.preset));
    this.circle.setAttribute("aria-pressed", String(isCircle(this.draft.azimuth)));
    const names = { low: "Lowest", high: "Highest", left: "From", right: "To", overlap: "Overlap" };
    this.fault.textContent = Object.entries(wrong).map(([key, why]) => `${names[key]} ${why}.`).join(" ");
    this.fault.hidden = !this.fault.textContent;
  }
  typed() {
    const read = (key) => { const { value } = this.form.querySelector(`#n-${key}`); return value.trim() === "" ? NaN : Number(value); };
    const overlap = Number(this.slider.value);
    this.change({ ...this.draft, camera: this.select.value, ...(overlap === Math.round(100 * this.draft.overlap) ? {} : { overlap: overlap / 100, ownOverlap: true }), elevation: [read("low"), read("high")], azimuth: [read("left"), read("right")] });
  }
  toggleCircle() {
    const yaw = Math.round(this.map.yaw);
    this.change({ ...this.draft, azimuth: isCircle(this.draft.azimuth) ? [yaw - 60, yaw + 60] : [-180, 180] });
  }
  preset(one) {
    this.change(presetDraft(this.draft, one));
    this.select.value = this.draft.camera;
    const field = this.form.querySelector("#n-name");
    if (!field.value) field.value = one.name || "";
  }
  places() {
    const basis = this.map.basis();
    return this.draft ? handles(this.draft, this.map.yaw).map((one) => ({ ...one, at: this.map.place(direction(one.elevation, one.azimuth), basis) })).filter((one) => one.at) : [];
  }
  grab([x, y]) {
    const near = this.places().map((one) => ({ ...one, far: Math.hypot(one.at[0] - x, one.at[1] - y) })).filter((one) => one.far <= REACH_PX).sort((a, b) => a.far - b.far)[0];
    if (!near) return null;
    this.held = near.edge;
    return (d, ended) => {
      if (d) this.change(dragged(this.draft, near.edge, elevationOf(d), azimuthOf(d)), { later: !ended });
      if (ended) this.held = null;
    };
  }
  drawBand() {
    const { map, draft } = this, c = map.context, basis = map.basis();
    if (!draft || Object.keys(faults(draft)).length) return;
    const [low, high] = draft.elevation, [left, right] = draft.azimuth, steps = [...Array(73).keys()].map((k) => left + ((right - left) * k) / 72);
    const edges = [steps.map((a) => direction(high, a)), steps.map((a) => direction(low, a))];
    if (!isCircle(draft.azimuth)) for (const a of [left, right]) edges.push([...Array(25).keys()].map((k) => direction(low + ((high - low) * k) / 24, a)));
    c.strokeStyle = colour("accent"); c.lineWidth = 3;
    for (const edge of edges) map.line(edge, basis);
    this.drawView(c, basis);
    const told = {};
    c.font = "700 16px system-ui, sans-serif"; c.textBaseline = "middle";
    for (const one of this.places()) {
      const [x, y] = one.at, held = this.held === one.edge;
      told[one.edge] = [Math.round(x), Math.round(y)];
      c.beginPath(); c.arc(x, y, held ? 19 : 16, 0, 2 * Math.PI);
      c.fillStyle = colour("accent"); c.fill();
      c.strokeStyle = colour("card"); c.lineWidth = 3; c.stroke();
      c.beginPath();
      if (one.edge === "high" || one.edge === "low") { c.moveTo(x - 5, y - 3); c.lineTo(x, y - 9); c.lineTo(x + 5, y - 3); c.moveTo(x - 5, y + 3); c.lineTo(x, y + 9); c.lineTo(x + 5, y + 3); } else { c.moveTo(x - 3, y - 5); c.lineTo(x - 9, y); c.lineTo(x - 3, y + 5); c.moveTo(x + 3, y - 5); c.lineTo(x + 9, y); c.lineTo(x + 3, y + 5); }
      c.strokeStyle = colour("card"); c.lineWidth = 2.4; c.stroke();
      const value = { high, low, left, right }[one.edge], text = minus(`${value}°`);
      const mirrored = x + 76 > map.width, at = mirrored ? x - 24 : x + 24;
      c.textAlign = mirrored ? "right" : "left";
      c.lineWidth = 4; c.strokeStyle = colour("card"); c.strokeText(text, at, y); c.fillStyle = colour("ink"); c.fillText(text, at, y);
    }
    map.canvas.dataset.handles = JSON.stringify(told);
  }
  /* The field of view of one image, in the middle of what one looks at. */
  drawView(c, basis) {
    if (!this.answer || !this.answer.ok || !this.map.half) return;
    const level = Math.max(this.draft.elevation[0], Math.min(this.draft.elevation[1], this.map.pitch));
    c.setLineDash([9, 6]); c.lineWidth = 2.4; c.strokeStyle = colour("patch");
    this.map.line(outlineOf(levelMatrix(level, this.map.yaw), ...this.map.half), basis);
    c.setLineDash([]);
  }
  draw() {
    const { model } = this.page, data = this.data, { answer, draft } = this, fresh = Boolean(answer && answer.ok && draft && sameDraft(answer.draft, draft) && !this.asking);
    const rough = draft && !fresh && !Object.keys(faults(draft)).length ? guess(draft, this.known) : null;
    const have = data && data.state ? data.state.battery_frac : null;
    redraw(this.verdict, [answer && [answer.ok, answer.text, answer.images, answer.duration_s, answer.battery_need_frac, answer.notes, answer.certificate], fresh, rough, Math.round(100 * (have || 0))], () => this.costs(answer, fresh, rough, have));
    const reason = draft ? startReason({ answer, draft, asking: Boolean(this.asking || this.started), may: data ? (data.may || {}).start : "nothing was heard from the vehicle yet", role: model.hello ? model.hello.role : "viewer", lost: model.lostSince !== null }) : "the plan is being computed";
    const summary = fresh ? [plural(answer.images, "image"), `${clock(answer.duration_s)} min`, isNumber(answer.battery_need_frac) ? `${percent(answer.battery_need_frac, 0)} of the battery` : null, certificateLine(answer).ok ? "proven complete" : "not proven complete"].filter(Boolean).join(" · ") : "";
    redraw(this.act, [reason, this.problem, Boolean(this.started), summary], () => el("div", { class: "actions" },
      button(this.started ? "Starting …" : "Start", { key: "start", id: "do-start", class: "big solid primary", reason: this.started ? "sent" : reason, onclick: () => this.start(), refused: (why) => toast("why", `Start: ${why}`) }),
      summary ? el("p", { class: "why" }, summary) : null, reason && !this.started ? el("p", { class: "why" }, `Start: ${reason}.`) : null, this.problem ? el("p", { class: "stage bad", role: "alert" }, el("b", {}, "refused"), el("span", {}, this.problem)) : null));
  }
  costs(answer, fresh, rough, have) {
    if (!answer) return [el("p", { class: "muted" }, "The vehicle computes its usual plan …")];
    if (!answer.ok && !this.asking) return [el("p", { class: "certificate bad", role: "alert" }, el("b", {}, "✗"), el("span", {}, answer.text))];
    const shown = fresh ? answer : { ...(rough || {}), about: true };
    const need = fresh ? answer.battery_need_frac : null, short = isNumber(need) && isNumber(have) && need > have;
    const line = fresh ? certificateLine(answer) : null, about = fresh ? "" : "about ";
    return [
      el("div", { class: "figures", id: "costs", "data-fresh": fresh ? "yes" : "no" }, figure("images", isNumber(shown.images) ? `${about}${shown.images}` : "…"), figure("time", isNumber(shown.duration_s) ? `${about}${clock(shown.duration_s)}` : "…", "min"),
        figure(isNumber(have) ? `battery, of ${percent(have, 0)}` : "battery", isNumber(need) ? percent(need, 0) : fresh ? "unknown" : "…", "", short ? "alarm" : ""),
        fresh && answer.rows ? figure(answer.rows === 1 ? "row" : "rows", String(answer.rows)) : null),
      line ? el("p", { class: `certificate ${line.ok ? "good" : "bad"}`, id: "certificate-line" }, el("b", {}, line.ok ? "✓" : "✗"), el("span", {}, line.text)) : el("p", { class: "certificate muted" }, el("b", {}, "…"), el("span", {}, "being computed and proven by the vehicle")),
      fresh && answer.camera ? el("p", { class: "muted small" }, `${answer.camera.name}: one image sees ${Math.round(answer.camera.hfov_deg)}° × ${Math.round(answer.camera.vfov_deg)}° (dashed). ${answer.estimate && answer.estimate.panorama_px ? `Panorama ${answer.estimate.panorama_px[0]} × ${answer.estimate.panorama_px[1]} px.` : ""}`) : null,
      short ? el("p", { class: "stage bad" }, el("b", {}, "The battery does not last for this plan.")) : null,
      fresh && answer.notes ? answer.notes.map((note) => el("p", { class: "muted small" }, note)) : null,
    ];
  }
  async start() {
    const { answer } = this;
    if (!certificateLine(answer).ok && !(await ask({ title: "Start without a proof?", text: `This plan is not proven complete: ${certificateLine(answer).text}`, yes: "Start", kind: "warn" }))) return;
    if (this.answer !== answer || this.started) return;
    this.problem = "";
    const name = this.form.querySelector("#n-name").value.trim();
    this.started = this.page.link.command(this.vehicle, "start", { plan: answer.plan, ...(answer.draft.preset ? { preset: answer.draft.preset } : {}), ...(name ? { name } : {}) });
    toast("command", `Start: sent, ${plural(answer.images, "image")}`);
    this.draw();
  }
}
