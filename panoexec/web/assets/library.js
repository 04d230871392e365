/* Missions after they were flown: a library, and one mission with report, downloads, stitching. */
import { el, isNumber, plural } from "/assets/pages/elements.js";
import { ask, toast } from "./dialogs.js";
import { ENDED, STATES, sentence } from "./model.js";
import { button, dateOf, redraw } from "./render.js";

const size = (bytes) => (!isNumber(bytes) ? "" : bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : bytes < 1e9 ? `${Math.round(bytes / 1e6)} MB` : `${(bytes / 1e9).toFixed(1)} GB`);
const place = (spot) => (spot && isNumber(spot.latitude_deg) && isNumber(spot.longitude_deg) ? `${Math.abs(spot.latitude_deg).toFixed(4)}° ${spot.latitude_deg < 0 ? "S" : "N"}, ${Math.abs(spot.longitude_deg).toFixed(4)}° ${spot.longitude_deg < 0 ? "W" : "E"}` : "");
const stateOf = (mission) => STATES[mission.state] || [mission.state || "unknown", ""];
const nameOf = (mission) => mission.name || mission.mission_id;
/* A mission id is the time of its beginning. */
const timeOfId = (id) => id.replace(/^(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d).*$/, "$1-$2-$3T$4:$5:$6Z");

/* What both views need: the list of the server, or that of the vehicle where the server stores nothing. */
class Missions {
  constructor(page, vehicle) {
    Object.assign(this, { page, vehicle, missions: null, storage: true, problem: "", library: -1, asked: null });
  }
  async read() {
    this.library = this.page.model.library;
    try {
      const answer = await fetch("/api/missions", { cache: "no-store", credentials: "same-origin" });
      if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
      const told = await answer.json();
      this.storage = told.storage;
      this.problem = "";
      if (told.storage) this.missions = told.missions;
      else if (this.vehicle) this.asked = this.page.link.command(this.vehicle, "missions", { newest: 30 });
      else this.missions = [];
    } catch (error) { this.problem = `The missions could not be read: ${error.message}.`; }
    this.changed();
  }
  update() {
    if (this.library !== this.page.model.library) this.read();
    const answer = this.asked && this.page.model.answers.get(this.asked);
    if (answer && ["done", "refused", "failed"].includes(answer.stage)) {
      this.asked = null;
      if (answer.stage === "done") this.missions = [...answer.data.missions].reverse().map((one) => ({ ...one, time: timeOfId(one.mission_id), remote: true }));
      else this.problem = answer.error ? answer.error.message || answer.error.code : "The vehicle did not answer.";
    }
    this.changed();
  }
}

export class LibraryView extends Missions {
  constructor(page, vehicle) {
    super(page, vehicle);
    this.title = "Missions";
    this.note = el("p", { class: "card", hidden: true });
    this.list = el("ul", { class: "cards", id: "missions" });
    this.node = el("div", { class: "column" }, el("h1", {}, "Missions"), this.note, this.list);
    this.read();
  }
  changed() {
    const { missions } = this, empty = !missions ? "Reading the list …" : !missions.length ? (this.storage || this.vehicle ? "No mission was flown yet." : "No missions are stored on this computer. A vehicle's page lists those of the vehicle.") : "";
    const where = missions && missions.length && !this.storage ? `Stored on ${this.vehicle}. Bring them here with: panoexec fetch.` : "";
    this.note.textContent = this.problem || empty || where;
    this.note.hidden = !this.note.textContent;
    const stitches = [...this.page.model.stitches.values()].map((one) => [one.mission_id, one.stage, one.fraction]);
    redraw(this.list, [missions, stitches], () => (missions || []).map((one) => el("li", {}, this.card(one))));
  }
  card(one) {
    const [word, kind] = stateOf(one), stitch = this.page.model.stitches.get(one.mission_id), base = this.vehicle ? `/v/${this.vehicle}` : "/";
    const facts = [dateOf(one.time || timeOfId(one.mission_id)), `${one.shots_done} of ${one.shots_total} shots`, one.photos ? plural(one.photos, "photo") : "no photos here", size(one.size_bytes)].filter(Boolean).join(" · ");
    const inner = [
      one.preview ? el("img", { class: "picture", src: one.preview, alt: "", loading: "lazy", decoding: "async" }) : el("span", { class: "picture none" }, "no picture yet"),
      el("span", { class: "inner" }, el("span", { class: "top" }, el("b", {}, nameOf(one)), el("span", { class: `pill ${kind}` }, word)), el("span", { class: "line" }, facts), place(one.place) ? el("span", { class: "line" }, place(one.place)) : null,
        stitch && stitch.stage === "running" ? el("span", { class: "line why" }, "being stitched …") : null, one.problem ? el("span", { class: "line why" }, sentence(one.problem)) : null),
    ];
    if (one.remote) return el("div", { class: `card mission ${kind}` }, inner);
    return el("a", { class: `card mission ${kind}`, href: `${base}#mission=${one.mission_id}`, "data-nav": `${base}#mission=${one.mission_id}`, "data-mission": one.mission_id, "data-key": one.mission_id }, inner);
  }
}

export class MissionView extends Missions {
  constructor(page, vehicle, id) {
    super(page, vehicle);
    Object.assign(this, { id, gone: false, looks: 0, looking: false });
    this.head = el("section", { class: "card column", "aria-label": "Mission" });
    this.report = el("section", { class: "card", "aria-label": "Report", hidden: true });
    this.node = el("div", { class: "column" }, this.head, this.report);
    this.read();
  }
  get mission() { return (this.missions || []).find((one) => one.mission_id === this.id) || null; }
  get title() { return this.mission ? nameOf(this.mission) : "Mission"; }
  changed() {
    const { mission } = this, { model } = this.page, stitch = model.stitches.get(this.id) || null, lost = model.lostSince !== null, viewer = Boolean(model.hello && model.hello.role === "viewer");
    redraw(this.head, [mission, stitch, lost, viewer, this.problem, this.missions === null, this.awaitsReport(mission)], () => this.headOf(mission, stitch, lost, viewer));
    const report = mission && mission.report;
    this.awaitReport(mission);
    this.report.hidden = !report;
    redraw(this.report, [report, report && mission.shots_done, stitch && stitch.stage === "done"], () => (report ? [el("h2", {}, "Panorama and report"), el("iframe", { class: "report", src: report, title: `Report of ${nameOf(mission)}: panorama viewer, sphere, errors, certificate`, loading: "lazy" })] : []));
  }
  headOf(mission, stitch, lost, viewer) {
    const back = el("a", { class: "button plain", href: `${this.vehicle ? `/v/${this.vehicle}` : "/"}#missions`, "data-nav": `${this.vehicle ? `/v/${this.vehicle}` : "/"}#missions`, "data-key": "back" }, "← All missions");
    if (!mission) return [el("h1", {}, "Mission"), el("p", {}, this.problem || (this.missions === null ? "Reading …" : this.gone ? "The mission was deleted." : "This computer does not have the mission.")), el("div", { class: "row" }, back)];
    const [word, kind] = stateOf(mission), running = Boolean(stitch && stitch.stage === "running");
    const blocked = lost ? "no connection to the server" : viewer ? "you are logged in as a viewer" : "";
    const no = (why, name) => (why ? `${name}: ${why}.` : "");
    const reasons = [no(blocked || mission.stitch, "Stitch"), no(blocked || mission.deletable, "Delete")].filter(Boolean).join(" ");
    const refused = (name) => (why) => toast("why", `${name}: ${why}`);
    return [
      el("div", { class: "row" }, el("h1", {}, nameOf(mission)), el("span", { class: `pill ${kind}`, id: "mission-state" }, word)),
      el("p", {}, [dateOf(mission.time || timeOfId(mission.mission_id)), place(mission.place), `${mission.shots_done} of ${mission.shots_total} shots`, plural(mission.photos || 0, "photo"), size(mission.size_bytes)].filter(Boolean).join(" · ")),
      mission.problem ? el("p", { class: "bad-text" }, sentence(mission.problem)) : null,
      el("div", { class: "row" },
        el("a", { class: "button big solid", id: "download", href: mission.download || `/missions/${mission.mission_id}/download`, download: `${mission.mission_id}.zip`, "data-key": "download" }, "Download all (zip)"),
        mission.report ? el("a", { class: "button big plain", id: "open-report", href: mission.report, target: "_blank", rel: "noopener", "data-key": "report" }, "Open report") : null,
        mission.panorama ? el("a", { class: "button big plain", id: "panorama", href: mission.panorama, download: true, "data-key": "panorama" }, "Download panorama") : null,
        button(running ? "Stitching …" : mission.panorama ? "Stitch again" : "Stitch", { key: "stitch", id: "stitch", class: "big plain", reason: blocked || mission.stitch, onclick: () => this.page.link.stitch(mission.mission_id), refused: refused("Stitch") }),
        button("Delete", { key: "delete", id: "delete", class: "big outline-bad", reason: blocked || mission.deletable, onclick: () => this.remove(mission), refused: refused("Delete") }), back),
      reasons ? el("p", { class: "muted small" }, reasons) : null,
      this.awaitsReport(mission) ? el("p", { class: "muted small", id: "report-awaited" }, "There is no report yet, which is written after the mission: a download does not have it.") : null,
      stitch ? el("div", { id: "stitching", role: "status" }, isNumber(stitch.fraction) ? el("progress", { max: 1, value: stitch.fraction, "aria-label": "Stitching" }) : null,
        el("p", { class: `stage ${{ running: "run", done: "good", failed: "bad" }[stitch.stage] || ""}` }, el("b", {}, { running: "stitching", done: "stitched", failed: "not stitched" }[stitch.stage] || stitch.stage), el("span", {}, [stitch.text, stitch.who].filter(Boolean).join(" · ")))) : null,
    ];
  }
  /* A mission is complete before its report is written: look again, for two minutes, while it is shown. */
  awaitsReport(mission) { return Boolean(mission && !mission.report && !mission.remote && ENDED.has(mission.state) && this.looks < 60); }
  awaitReport(mission) {
    if (!this.awaitsReport(mission) || this.looking) return;
    this.looking = true;
    this.looks += 1;
    setTimeout(() => { this.looking = false; if (this.node.isConnected) this.read(); }, 2000);
  }
  async remove(mission) {
    const yes = await ask({ title: "Delete the mission?", text: `${nameOf(mission)}: ${plural(mission.photos || 0, "photo")}, ${size(mission.size_bytes)}. Photos, report and panorama are removed from this computer for good.`, yes: "Delete", kind: "bad" });
    if (!yes) return;
    try {
      const answer = await fetch(`/missions/${encodeURIComponent(mission.mission_id)}`, { method: "DELETE", headers: { "X-Confirm": mission.mission_id }, credentials: "same-origin" });
      if (answer.status !== 204) {
        const told = await answer.json().catch(() => ({}));
        throw new Error(told.error || `the server answered ${answer.status}`);
      }
      this.gone = true;
      toast("delete", `${nameOf(mission)} was deleted.`, "good");
      this.page.go(`${this.vehicle ? `/v/${this.vehicle}` : "/"}#missions`);
    } catch (error) { toast("delete", `Not deleted: ${error.message}`, "bad"); }
  }
}
