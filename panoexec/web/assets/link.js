/* The WebSocket to the server: reconnects for ever, repeats commands that were not answered. */
import { check, take } from "./model.js";

const PAUSES_MS = [300, 700, 1000, 1000, 1500, 2000];
const REPEAT_MS = 10000;
const FINAL = new Set(["done", "refused", "failed"]);

export class Link {
  constructor(model, changed) {
    this.model = model;
    this.changed = changed;
    this.tries = 0;
    this.open = new Map();
    this.following = null;
    this.name = "";
    this.connect();
    this.wasLost = false;
    setInterval(() => {
      const lost = check(model);
      if (lost && this.socket && Date.now() - model.heardAt > 4500 && this.socket.readyState === 1) this.socket.close();
      if (lost !== this.wasLost) { this.wasLost = lost; changed(["lost"]); } else if (lost) changed(["lost-clock"]);
    }, 250);
  }
  connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
    this.socket = socket;
    let opened = false;
    socket.addEventListener("open", () => {
      opened = true;
      this.tries = 0;
      this.model.connected = true;
      if (this.name) this.send({ type: "name", name: this.name });
      this.send({ type: "follow", vehicle: this.following });
      for (const [id, { message, at }] of this.open) {
        if (Date.now() - at <= REPEAT_MS) { this.send(message); continue; }
        // what was wanted then may be wrong now: somebody has to look first
        this.open.delete(id);
        const error = { code: "lost", message: "the connection was lost before the answer; look at the state, then command again" };
        const answer = { type: "answer", id, vehicle: message.vehicle, command: message.command, stage: "failed", error, data: null };
        this.changed(take(this.model, answer), answer);
      }
    });
    socket.addEventListener("message", (event) => {
      const message = JSON.parse(event.data);
      if (message.type === "answer" && FINAL.has(message.stage)) this.open.delete(message.id);
      this.changed(take(this.model, message), message);
    });
    socket.addEventListener("close", () => {
      if (this.socket !== socket) return;
      this.model.connected = false;
      check(this.model);
      this.changed(["lost"]);
      const again = () => setTimeout(() => this.connect(), PAUSES_MS[Math.min(this.tries++, PAUSES_MS.length - 1)]);
      if (opened) { again(); return; }
      // a socket does not tell why it was refused; the page does
      fetch("/api/missions", { method: "GET", credentials: "same-origin", cache: "no-store" }).then((answer) => {
        if (answer.status === 401) location.assign("/login"); else again();
      }, again);
    });
  }
  send(message) {
    if (this.socket.readyState === 1) this.socket.send(JSON.stringify(message));
  }
  follow(vehicle) {
    this.following = vehicle;
    if (!this.model.vehicle || this.model.vehicle.id !== vehicle) this.model.vehicle = null;
    this.send({ type: "follow", vehicle });
  }
  rename(name) {
    this.name = name;
    this.send({ type: "name", name });
  }
  /* Returns the id of the command. */
  command(vehicle, command, fields = {}) {
    const id = [...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    const message = { type: "command", id, vehicle, command, fields };
    this.open.set(id, { message, at: Date.now() });
    this.send(message);
    return id;
  }
  stitch(mission_id) { this.send({ type: "stitch", mission_id }); }
}
