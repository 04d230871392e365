/* A sphere seen from inside (photos are not mirrored), or a flat map: texture, grid, and what its layers draw on it. */
import { colour, el, responsive } from "./elements.js";
import { RAD, azimuthOf, direction, elevationOf, wrap } from "./sphere_math.js";
"use strict";

export class SphereView {
  /* layers: functions (view, basis) that draw, in order. hovered, picked: called with the direction under the pointer, or
     null. grab: called with the direction where a drag begins; returns a function (direction or null, ended) that takes
     the drag over, or null. */
  constructor(canvas, { layers = [], hovered = () => {}, picked = () => {}, grab = () => null, tallest = 560 } = {}) {
    Object.assign(this, { canvas, layers, hovered, picked, grab, tallest });
    this.context = canvas.getContext("2d");
    this.sheet = el("canvas");
    this.yaw = 0;
    this.pitch = -25;
    this.zoom = 1;
    this.north = 0;
    this.view = "ball";
    this.texture = null;
    this.onPhotos = false;
    this.drag = null;
    this.width = this.height = 0;
    this.ratio = 1;
    this.dragScale = 0.6;
    this.frames = 0;
    this.listen();
    responsive(canvas.parentElement, (width) => {
      this.resized();
      this.resize(width);
    });
  }
  /* Called before each resize and after a change of the colour scheme. */
  resized() {}
  resize(width) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.width = width;
    this.height = this.view === "ball" ? Math.min(width, this.tallest) : width / 2;
    this.canvas.style.height = `${this.height}px`;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ratio = ratio;
    this.ask();
  }
  show(view) {
    this.view = view;
    this.resize(this.canvas.parentElement.clientWidth);
  }
  look(d) {
    this.yaw = azimuthOf(d);
    this.pitch = Math.max(-80, Math.min(80, elevationOf(d)));
  }
  ask() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }
  get radius() { return (Math.min(this.width, this.height) / 2 - 8) * this.zoom; }
  basis() {
    const cy = Math.cos(this.yaw * RAD), sy = Math.sin(this.yaw * RAD), cp = Math.cos(this.pitch * RAD), sp = Math.sin(this.pitch * RAD);
    return { ahead: [cp * cy, cp * sy, -sp], right: [-sy, cy, 0], down: [sp * cy, sp * sy, cp] };
  }
  /* The canvas position of a direction; null if it is not visible. */
  place(d, basis) {
    if (this.view === "map") {
      return [this.width / 2 + (wrap(azimuthOf(d) - this.yaw) / 360) * this.width, (this.height / 180) * (90 - elevationOf(d))];
    }
    const dot = (a) => a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
    if (dot(basis.ahead) < 0) return null;
    return [this.width / 2 + this.radius * dot(basis.right), this.height / 2 + this.radius * dot(basis.down)];
  }
  /* The direction at a canvas position; null beside the sphere, or with `nearest` the one at its edge. */
  at(x, y, nearest = false) {
    if (this.view === "map") {
      return direction(90 - (Math.max(0, Math.min(this.height, y)) / this.height) * 180, wrap(this.yaw + ((x - this.width / 2) / this.width) * 360));
    }
    let u = (x - this.width / 2) / this.radius, v = (y - this.height / 2) / this.radius, n = u * u + v * v;
    if (n > 1) {
      if (!nearest) return null;
      u /= Math.sqrt(n); v /= Math.sqrt(n); n = 1;
    }
    const { ahead, right, down } = this.basis(), w = Math.sqrt(1 - n);
    return [0, 1, 2].map((k) => w * ahead[k] + u * right[k] + v * down[k]);
  }
  draw() {
    if (!this.width) return;
    const { context: c, ratio } = this, basis = this.basis();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.width, this.height);
    if (this.texture) this.drawTexture(basis);
    this.drawGrid(basis);
    c.lineJoin = "round";
    for (const layer of this.layers) {
      c.globalAlpha = 1;
      c.setLineDash([]);
      layer(this, basis);
    }
    c.globalAlpha = 1;
    c.setLineDash([]);
    this.frames += 1;
    const state = this.canvas.dataset;
    state.yaw = this.yaw.toFixed(2); state.pitch = this.pitch.toFixed(2); state.view = this.view;
  }
  drawTexture({ ahead, right, down }) {
    const { texture } = this, scale = this.drag ? this.dragScale : Math.min(1.5, this.ratio);
    if (this.view === "map") {
      const sheet = this.asCanvas(texture), shift = ((this.yaw % 360) / 360) * this.width;
      for (const k of [-2, -1, 0, 1, 2]) this.context.drawImage(sheet, k * this.width - shift, 0, this.width, this.height);
      return;
    }
    const w = Math.round(this.width * scale), h = Math.round(this.height * scale), r = this.radius * scale;
    const key = `${this.yaw} ${this.pitch} ${w} ${h} ${r} ${texture.version || 0}`;
    if (key !== this.sheetKey || this.sheetOf !== texture) {
      this.sheetKey = key;
      this.sheetOf = texture;
      const begun = performance.now();
      this.project(texture, w, h, r, ahead, right, down);
      // coarser while it is dragged on a slow computer: the sphere has to follow the finger
      if (this.drag) this.dragScale = Math.max(0.35, Math.min(0.6, this.dragScale * (performance.now() - begun > 8 ? 0.93 : 1.04)));
    }
    this.context.imageSmoothingEnabled = true;
    this.context.drawImage(this.sheet, 0, 0, this.width, this.height);
    this.context.beginPath();
    this.context.arc(this.width / 2, this.height / 2, this.radius, 0, 2 * Math.PI);
    this.context.strokeStyle = colour("line"); this.context.lineWidth = 1.5;
    this.context.stroke();
  }
  /* The texture as it is seen on the sphere. */
  project(texture, w, h, r, ahead, right, down) {
    const image = this.context.createImageData(w, h), out = new Uint32Array(image.data.buffer), { width, height } = texture;
    const pixels = new Uint32Array(texture.pixels.buffer, texture.pixels.byteOffset, width * height);
    const kx = width / (2 * Math.PI), ky = height / Math.PI;
    for (let j = 0; j < h; j += 1) {
      const v = (j + 0.5 - h / 2) / r, v2 = v * v;
      if (v2 >= 1) continue;
      const half = Math.sqrt(1 - v2) * r, from = Math.max(0, Math.ceil(w / 2 - half)), to = Math.min(w, Math.floor(w / 2 + half));
      for (let i = from; i < to; i += 1) {
        const u = (i + 0.5 - w / 2) / r, z = Math.sqrt(Math.max(0, 1 - u * u - v2));
        const x = z * ahead[0] + u * right[0] + v * down[0], y = z * ahead[1] + u * right[1] + v * down[1];
        const s = z * ahead[2] + u * right[2] + v * down[2];
        const column = Math.min(width - 1, ((Math.atan2(y, x) + Math.PI) * kx) | 0);
        const row = Math.min(height - 1, ((Math.asin(s < -1 ? -1 : s > 1 ? 1 : s) + Math.PI / 2) * ky) | 0);
        const p = pixels[row * width + column], light = (184 + 72 * z) | 0;
        // the channels times the light, in 256ths; two at a time
        out[j * w + i] = 0xff000000 | ((((p & 0xff00ff) * light) >>> 8) & 0xff00ff) | ((((p & 0xff00) * light) >>> 8) & 0xff00);
      }
    }
    this.sheet.width = w; this.sheet.height = h;
    this.sheet.getContext("2d").putImageData(image, 0, 0);
  }
  asCanvas(texture) {
    if (!texture.sheet) {
      texture.sheet = el("canvas", { width: texture.width, height: texture.height });
      texture.sheet.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(texture.pixels), texture.width, texture.height), 0, 0);
    }
    return texture.sheet;
  }
  drawGrid(basis) {
    const c = this.context, light = this.onPhotos;
    c.lineWidth = 0.7;
    c.strokeStyle = light ? "rgba(255,255,255,.28)" : colour("muted");
    c.globalAlpha = light ? 1 : 0.35;
    const steps = [...Array(61).keys()];
    for (let a = -180; a < 180; a += 30) this.line(steps.map((k) => direction(-90 + 3 * k, a)), basis);
    for (const e of [-60, -30, 30, 60]) this.line(steps.map((k) => direction(e, -180 + 6 * k)), basis);
    c.lineWidth = 1.6; c.globalAlpha = light ? 1 : 0.7;
    this.line(steps.map((k) => direction(0, -180 + 6 * k)), basis);
    c.globalAlpha = 1;
    c.font = "600 12px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "middle";
    const names = [["N", 0], ["E", 90], ["S", 180], ["W", -90]];
    for (const [name, heading] of names) this.label(name, direction(0, heading - this.north), basis);
    this.label("nadir", direction(-90, 0), basis);
    this.label("zenith", direction(90, 0), basis);
  }
  label(text, d, basis) {
    const p = this.place(d, basis), c = this.context;
    if (!p || (this.view === "map" && (text === "nadir" || text === "zenith"))) return;
    c.lineWidth = 3.5; c.strokeStyle = this.onPhotos ? "rgba(0,0,0,.65)" : colour("card"); c.strokeText(text, ...p);
    c.fillStyle = this.onPhotos ? "#fff" : colour("ink"); c.fillText(text, ...p);
  }
  line(points, basis) {
    const c = this.context;
    let before = null;
    c.beginPath();
    for (const d of points) {
      const p = this.place(d, basis);
      const cut = !p || !before || (this.view === "map" && Math.abs(p[0] - before[0]) > this.width / 2);
      if (p) { if (cut) c.moveTo(...p); else c.lineTo(...p); }
      before = p;
    }
    c.stroke();
  }
  dot(d, basis, style, size) {
    const p = this.place(d, basis);
    if (!p) return;
    this.context.fillStyle = style;
    this.context.beginPath(); this.context.arc(p[0], p[1], size, 0, 2 * Math.PI); this.context.fill();
  }
  turn(yaw, pitch) {
    this.yaw = wrap(this.yaw + yaw);
    this.pitch = Math.max(-90, Math.min(90, this.pitch + pitch));
    this.ask();
  }
  zoomBy(factor) { this.zoom = Math.max(1, Math.min(6, this.zoom * factor)); this.ask(); }
  listen() {
    const { canvas } = this;
    const where = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button || this.drag) return;
      const d = this.at(...where(event));
      this.drag = { at: [event.clientX, event.clientY], moved: false, id: event.pointerId, taken: this.grab(d, where(event)) };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const d = this.drag;
      if (d) {
        if (event.pointerId !== d.id) return;
        const dx = event.clientX - d.at[0], dy = event.clientY - d.at[1];
        if (!d.moved && Math.hypot(dx, dy) < 5) return;
        d.moved = true; d.at = [event.clientX, event.clientY];
        if (d.taken) { d.taken(this.at(...where(event), true), false); this.ask(); return; }
        canvas.classList.add("turning");
        const per = this.view === "map" ? 360 / this.width : 1 / RAD / this.radius;
        this.turn(-dx * per, this.view === "map" ? 0 : dy * per);
        return;
      }
      this.hovered(this.at(...where(event)));
    });
    const end = (event) => {
      const d = this.drag;
      if (d && event.pointerId !== d.id) return;
      this.drag = null;
      canvas.classList.remove("turning");
      if (d && d.taken) d.taken(this.at(...where(event), true), true);
      else if (d && !d.moved && event.type === "pointerup") this.picked(this.at(...where(event)));
      this.ask();
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => { if (!this.drag) this.hovered(null); });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10] };
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      if (steps[event.key]) this.turn(...steps[event.key]);
      else if (event.key === "+") this.zoomBy(1.3);
      else if (event.key === "-") this.zoomBy(1 / 1.3);
      else return;
      event.preventDefault();
    });
  }
}
