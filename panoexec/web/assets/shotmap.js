/* The sphere of the live view: photos, footprints in the colours of their state, ties, the camera's direction. */
import { colour, el } from "/assets/pages/elements.js";
import { arc, azimuthOf, boresightOf, circleAround, depthIn, elevationOf, levelMatrix, matrix, outlineOf, wrap } from "/assets/pages/sphere_math.js";
import { SphereView } from "/assets/pages/sphere_view.js";
import { STANDINGS, acceptedOf, standing } from "./model.js";
import { Mosaic } from "./mosaic.js";

const CHOSEN = "#ffd54a";
const CALM = window.matchMedia("(prefers-reduced-motion: reduce)");

export class ShotMap extends SphereView {
  /* picked: called with the shot that was tapped, or null. */
  constructor(canvas, pulse, { picked, grab = () => null, layers = [] }) {
    super(canvas, {
      layers: [() => this.drawShots(), () => this.drawTies(), () => this.drawTarget(), () => this.drawChosen(), ...layers, () => this.note()],
      picked: (d) => picked(d && this.shotAt(d)), grab,
    });
    Object.assign(this, { pulse, footprints: [], byIndex: new Map(), vehicle: null, chosen: null, followed: true, ties: 0, aim: null, shaded: false });
    this.mosaic = new Mosaic(() => this.ask());
    this.texture = this.mosaic.texture;
    this.outlines = new Map();
    canvas.addEventListener("pointerdown", () => { this.aim = null; });
    this.resized();
  }
  resized() {
    if (this.mosaic) this.mosaic.ground();
  }
  /* Shows a mission as the model has it; null clears. */
  take(vehicle) {
    this.vehicle = vehicle;
    const mission = vehicle && vehicle.mission;
    if (!mission || !mission.camera) {
      this.footprints = [];
      this.byIndex.clear();
      if (this.missionId !== null) { this.missionId = null; this.mosaic.band = null; this.mosaic.clear(); }
      this.ask();
      return;
    }
    const band = JSON.stringify(mission.band);
    if (this.missionId !== (mission.id || "") || this.bandText !== band) {
      this.missionId = mission.id || "";
      this.bandText = band;
      this.mosaic.band = mission.band && mission.band.known ? mission.band : null;
      this.mosaic.clear();
      this.outlines.clear();
    }
    const { half_width: w, half_height: h } = mission.camera;
    this.half = [w, h];
    this.footprints = mission.shots.filter((shot) => shot.q).map((shot) => {
      const taken = acceptedOf(shot), q = (taken && taken.q) || shot.q, key = `${shot.i} ${q.join(" ")}`;
      let shape = this.outlines.get(key);
      if (!shape) {
        const m = matrix(q);
        const outline = outlineOf(m, w, h);
        shape = { m, outline, coarse: outline.filter((_, k) => k % 3 === 0), boresight: boresightOf(m) };
        this.outlines.set(key, shape);
      }
      return { shot, i: shot.i, standing: standing(vehicle, shot), measured: Boolean(taken && taken.q), ...shape };
    });
    this.byIndex = new Map(this.footprints.map((one) => [one.i, one]));
    this.mosaic.show(mission.shots, mission.camera);
    this.onPhotos = this.mosaic.photos.size > 0;
    this.follow();
    this.ask();
  }
  get current() { return this.footprints.find((one) => one.standing === "current") || null; }
  /* Turns to the shot that is being taken, unless somebody turned the sphere. */
  follow() {
    const current = this.current;
    if (!this.followed || !current || this.drag || this.lastFollowed === current.i) return;
    this.lastFollowed = current.i;
    this.turnTo(current.boresight);
  }
  turnTo(d) {
    const yaw = azimuthOf(d), pitch = this.view === "map" ? this.pitch : Math.max(-60, Math.min(40, elevationOf(d)));
    if (CALM.matches) { this.yaw = yaw; this.pitch = pitch; this.ask(); return; }
    const aim = { yaw, pitch };
    this.aim = aim;
    const step = () => {
      if (this.aim !== aim) return;
      const dy = wrap(aim.yaw - this.yaw), dp = aim.pitch - this.pitch, near = Math.hypot(dy, dp) < 0.4;
      this.turn(near ? dy : dy * 0.25, near ? dp : dp * 0.25);
      if (near) this.aim = null; else requestAnimationFrame(step);
    };
    step();
  }
  shotAt(d) {
    let best = null, deepest = 0;
    for (const one of this.footprints) {
      const inside = depthIn(one.m, ...this.half, d);
      if (inside > deepest) { deepest = inside; best = one; }
    }
    return best && best.shot;
  }
  drawShots() {
    const c = this.context, basis = this.basis(), dense = this.footprints.length > 60, quick = dense && this.drag;
    const order = ["todo", "done", "retaken", "doubtful", "again", "missing", "current"];
    for (const key of order) {
      const [, name, dash] = STANDINGS[key];
      const strong = key !== "todo" && key !== "done";
      c.strokeStyle = key === "todo" && this.onPhotos ? "rgba(255,255,255,.8)" : colour(name);
      c.lineWidth = (strong ? 2.4 : 1.4) * (dense && !strong ? 0.7 : 1);
      for (const one of this.footprints) {
        if (one.standing !== key) continue;
        if (this.shaded && key === "todo") {
          c.globalAlpha = 0.1;
          c.fillStyle = colour("accent");
          this.fill(one.outline, basis);
        }
        if (["again", "missing", "current"].includes(key)) {
          c.globalAlpha = 0.16;
          c.fillStyle = colour(name);
          this.fill(one.outline, basis);
        }
        c.globalAlpha = key === "todo" ? 0.75 : 1;
        c.setLineDash(dash);
        this.line(quick ? one.coarse : one.outline, basis);
        if (!this.onPhotos) { c.setLineDash([]); this.dot(one.boresight, basis, colour(name), dense ? 1.8 : 2.8); }
      }
    }
  }
  /* Fills what of a footprint is visible: on the sphere to its edge, on the flat map in as many pieces as it has. */
  fill(points, basis) {
    const c = this.context;
    c.beginPath();
    if (this.view === "map") {
      const ring = [];
      let shift = 0;
      for (const d of points) {
        const [x, y] = this.place(d, basis), last = ring[ring.length - 1];
        if (last) shift += Math.round((last[0] - x - shift) / this.width) * this.width;
        ring.push([x + shift, y]);
      }
      const turnsAround = Math.abs(ring[ring.length - 1][0] - ring[0][0]) > this.width / 2;
      if (turnsAround) {
        const pole = elevationOf(points[0]) < 0 ? this.height : 0;
        ring.push([ring[ring.length - 1][0], pole], [ring[0][0], pole]);
      }
      for (const k of [-1, 0, 1]) ring.forEach(([x, y], i) => (i ? c.lineTo(x + k * this.width, y) : c.moveTo(x + k * this.width, y)));
    } else {
      const dot = (a, d) => a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
      if (!points.some((d) => dot(basis.ahead, d) > 0)) return;
      points.forEach((d, i) => {
        let u = dot(basis.right, d), v = dot(basis.down, d);
        const n = Math.hypot(u, v);
        if (dot(basis.ahead, d) < 0 && n > 0) { u /= n; v /= n; }
        const x = this.width / 2 + this.radius * u, y = this.height / 2 + this.radius * v;
        if (i) c.lineTo(x, y); else c.moveTo(x, y);
      });
    }
    c.fill();
  }
  /* Photos that their content ties to each other; red where a photo should be tied and is not. */
  drawTies() {
    const c = this.context, basis = this.basis(), mission = this.vehicle && this.vehicle.mission;
    this.ties = 0;
    if (!mission) return;
    const bridges = new Set(((mission.content && mission.content.bridges) || []).map(([a, b]) => `${Math.min(a, b)}-${Math.max(a, b)}`));
    const seen = new Set(), warn = colour("warn"), tied = colour("tie");
    for (const one of this.footprints) {
      const taken = acceptedOf(one.shot), content = taken && taken.content;
      if (!content) continue;
      for (const tie of content.ties) {
        const other = this.byIndex.get(tie.shot), key = `${Math.min(one.i, tie.shot)}-${Math.max(one.i, tie.shot)}`;
        if (!other || seen.has(key)) continue;
        seen.add(key);
        const bridge = bridges.has(key);
        c.strokeStyle = bridge ? warn : tied;
        c.lineWidth = bridge ? 2.4 : 1.3;
        c.globalAlpha = bridge ? 1 : 0.8;
        this.line(arc(one.boresight, other.boresight, this.drag ? 3 : 8), basis);
      }
      if (content.verdict === "untied" || content.verdict === "contradicts") {
        const near = this.footprints.filter((other) => other !== one && acceptedOf(other.shot))
          .map((other) => [other, other.boresight.reduce((sum, x, k) => sum + x * one.boresight[k], 0)]).sort((a, b) => b[1] - a[1]).slice(0, 2);
        c.strokeStyle = colour("bad"); c.lineWidth = 2.4; c.globalAlpha = 1;
        c.setLineDash([4, 3]);
        for (const [other] of near) this.line(arc(one.boresight, other.boresight), basis);
        c.setLineDash([]);
      }
      if (content.verdict === "geometry_only") this.dot(one.boresight, basis, colour("warn"), 4.5);
    }
    this.ties = seen.size;
  }
  /* The target with its tolerance as a circle, and the camera's direction now as a cross. */
  drawTarget() {
    const c = this.context, basis = this.basis(), current = this.current;
    const state = this.vehicle && this.vehicle.state, pose = state && state.pose, tau = this.vehicle && this.vehicle.mission && this.vehicle.mission.tolerance_deg;
    const at = current && this.place(current.boresight, basis);
    if (this.pulse) {
      this.pulse.hidden = !at;
      if (at) { this.pulse.style.left = `${at[0]}px`; this.pulse.style.top = `${at[1]}px`; }
    }
    if (current && tau) {
      c.strokeStyle = colour("accent"); c.lineWidth = 2;
      const radius = Math.max(tau.pitch || 0, tau.yaw || 0);
      if (radius * this.radius > 520) this.line(circleAround(current.boresight, radius), basis);
      else if (at) { c.beginPath(); c.arc(at[0], at[1], 9, 0, 2 * Math.PI); c.stroke(); }
    }
    if (pose && typeof pose.pitch_deg === "number" && typeof pose.yaw_deg === "number") {
      const p = this.place(boresightOf(levelMatrix(pose.pitch_deg, pose.yaw_deg)), basis);
      if (p) {
        for (const [style, width] of [["rgba(0,0,0,.6)", 5], ["#fff", 2.4]]) {
          c.strokeStyle = style; c.lineWidth = width;
          c.beginPath(); c.moveTo(p[0] - 13, p[1]); c.lineTo(p[0] + 13, p[1]); c.moveTo(p[0], p[1] - 13); c.lineTo(p[0], p[1] + 13); c.stroke();
        }
      }
    }
  }
  drawChosen() {
    const one = this.chosen === null ? null : this.byIndex.get(this.chosen);
    if (!one) return;
    const c = this.context, basis = this.basis();
    c.lineWidth = 6; c.strokeStyle = "rgba(0,0,0,.5)"; this.line(one.outline, basis);
    c.lineWidth = 3.4; c.strokeStyle = CHOSEN; this.line(one.outline, basis);
  }
  note() {
    const told = this.canvas.dataset, counted = {};
    for (const one of this.footprints) counted[one.standing] = (counted[one.standing] || 0) + 1;
    Object.assign(told, { shots: this.footprints.length, photos: this.mosaic.photos.size, laid: this.mosaic.texture.version, ties: this.ties, frames: this.frames });
    told.standings = JSON.stringify(counted);
    told.chosen = this.chosen === null ? "" : this.chosen;
    told.measured = this.footprints.filter((one) => one.measured).length;
  }
}

/* A canvas with its buttons: sphere or flat map, zoom, and what stands for the sphere without sight. */
export function mapCard(label, options) {
  const canvas = el("canvas", { id: options.id || "ball", tabindex: 0, role: "application", "aria-label": label });
  const pulse = el("div", { class: "pulse", hidden: true, "aria-hidden": "true" });
  const node = el("div", { class: "globe" }, canvas, pulse);
  const map = new ShotMap(canvas, pulse, options);
  const views = [["ball", "Sphere"], ["map", "Flat map"]].map(([view, text]) => el("button", { "data-view": view, "aria-pressed": String(map.view === view), onclick: () => {
    map.show(view);
    for (const button of views) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  } }, text));
  const follow = el("button", { "aria-pressed": "true", class: "plain", onclick: () => setFollow(!map.followed) }, "Follow");
  const setFollow = (on) => {
    map.followed = on;
    map.lastFollowed = null;
    follow.setAttribute("aria-pressed", String(on));
    if (on) map.follow();
  };
  canvas.addEventListener("pointermove", () => { if (map.drag && map.drag.moved && map.followed && !map.drag.taken) setFollow(false); });
  canvas.addEventListener("keydown", (event) => { if (event.key.startsWith("Arrow")) setFollow(false); });
  const zoom = [["\u2212", "Zoom out", 1 / 1.3], ["+", "Zoom in", 1.3]].map(([text, name, by]) => el("button", { "aria-label": name, onclick: () => map.zoomBy(by) }, text));
  const toolbar = el("div", { class: "toolbar", role: "group", "aria-label": "Map" }, el("span", { class: "toggle" }, views), options.follow === false ? null : follow);
  node.append(el("span", { class: "toggle zoom", role: "group", "aria-label": "Zoom" }, zoom));
  return { map, toolbar, node };
}
