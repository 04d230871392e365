/* What the server told, folded into one view; no element of the page, so that it can be tested alone.

   The messages are defined in panoexec/web/protocol.py. */

export const LOST_AFTER_MS = 3000;
const MOST_EVENTS = 300;

export const STATES = {
  idle: ["Ready", ""], preflight: ["Checking", "run"], capturing: ["Taking photos", "run"], paused: ["Paused", "warn"],
  finishing: ["Finishing", "run"], complete: ["Complete", "good"], incomplete: ["Incomplete", "warn"],
  aborted: ["Aborted", "bad"], failed: ["Failed", "bad"],
};
/* How a shot stands: word, colour of the theme, dash of its outline. */
export const STANDINGS = {
  done: ["done", "good", []], retaken: ["retaken", "warn", []], doubtful: ["doubtful", "doubt", [3, 3]], current: ["being taken", "accent", []],
  again: ["to be retaken", "warn", [6, 4]], missing: ["missing", "bad", [6, 4]], todo: ["planned", "muted", [2, 3]],
};
const LETTERS = { d: "done", r: "retaken", c: "current", a: "again", m: "missing", t: "todo" };
export const ENDED = new Set(["complete", "incomplete", "aborted", "failed"]);
const FLYING = new Set(["preflight", "capturing", "paused", "finishing"]);
const DOUBTFUL = new Set(["geometry_only", "unreadable", "exposure", "blurred", "untied", "contradicts"]);

export function newModel() {
  return {
    hello: null, link: { up: false, since: null, reason: "" }, cameras: [], vehicles: new Map(), vehicle: null, answers: new Map(),
    stitches: new Map(), library: 0, problem: "", heardAt: null, connected: false, lostSince: null,
  };
}

/* Takes one message; returns the names of what changed. */
export function take(model, message, now = Date.now()) {
  model.heardAt = now;
  model.lostSince = null;
  const own = model.vehicle && message.vehicle === model.vehicle.id ? model.vehicle : null;
  const mission = own && own.mission && (message.mission_id === undefined || message.mission_id === own.mission.id) ? own.mission : null;
  switch (message.type) {
    case "hello":
      model.hello = message;
      model.cameras = message.cameras || [];
      return ["hello"];
    case "cameras": model.cameras = message.cameras; return ["hello"];
    case "link":
      model.link = { up: message.up, since: message.since, reason: message.reason || "" };
      return ["link"];
    case "vehicles": model.vehicles = new Map(message.vehicles.map((one) => [one.id, { ...one, at: now }])); return ["fleet"];
    case "summaries": for (const one of message.vehicles) model.vehicles.set(one.id, { ...one, at: now }); return ["fleet"];
    case "vehicle":
      model.vehicle = {
        id: message.vehicle, status: message.status, state: message.state, may: message.may || {}, marks: message.marks || "",
        mission: message.mission, log: message.log || [], silent_s: message.silent_s,
      };
      return ["vehicle"];
    case "beat":
      if (model.vehicle) model.vehicle.silent_s = message.silent_s;
      return ["beat"];
    case "answer": model.answers.set(message.id, message); return ["answer"];
    case "stitch": model.stitches.set(message.mission_id, message); return ["stitch"];
    case "library": model.library += 1; return ["library"];
    case "problem": model.problem = message.text; return ["problem"];
    default: break;
  }
  if (!own) return [];
  switch (message.type) {
    case "status": own.status = message.status; return ["state"];
    case "state": Object.assign(own, { state: message.state, may: message.may || own.may, marks: message.marks ?? own.marks }); return ["state"];
    case "mission": own.mission = message.mission; return ["mission"];
    case "log": {
      const at = own.log.findIndex((entry) => entry.id === message.entry.id);
      if (at >= 0) own.log[at] = message.entry; else own.log.push(message.entry);
      return ["log"];
    }
    default: break;
  }
  if (!mission) return [];
  switch (message.type) {
    case "shot": {
      const at = mission.shots.findIndex((shot) => shot.i === message.shot.i);
      if (at >= 0) mission.shots[at] = message.shot; else mission.shots.push(message.shot);
      return ["shot"];
    }
    case "thumbnail": {
      const shot = mission.shots.find((one) => one.i === message.shot);
      if (shot) shot.url = message.url;
      return ["shot"];
    }
    case "content": mission.content = message.content; return ["shot"];
    case "event":
      mission.events.push(message.event);
      if (mission.events.length > MOST_EVENTS) mission.events.splice(0, mission.events.length - MOST_EVENTS);
      return ["event"];
    default: return [];
  }
}

/* Whether the server is lost: nothing for 3 s, or the socket is closed. */
export function check(model, now = Date.now()) {
  const lost = model.heardAt === null ? null : now - model.heardAt > LOST_AFTER_MS || !model.connected;
  if (lost && model.lostSince === null) model.lostSince = model.heardAt;
  if (lost === false) model.lostSince = null;
  return model.lostSince !== null;
}

export const acceptedOf = (shot) => shot.attempts.find((attempt) => attempt.n === shot.accepted) || null;
export const flying = (state) => Boolean(state) && FLYING.has(state.state);

/* How the shot stands, by the vehicle's own word, else by its attempts. */
export function standing(vehicle, shot) {
  const letter = vehicle.marks[shot.i], taken = acceptedOf(shot);
  let found = LETTERS[letter];
  if (!found) found = taken ? (shot.attempts.filter((one) => one.verdict !== "interrupted" && one.n <= taken.n).length > 1 ? "retaken" : "done") : "todo";
  if ((found === "done" || found === "retaken") && taken && taken.content && DOUBTFUL.has(taken.content.verdict)) return "doubtful";
  return found;
}
export function counts(vehicle) {
  const out = Object.fromEntries(Object.keys(STANDINGS).map((key) => [key, 0]));
  const shots = vehicle.mission ? vehicle.mission.shots : [], known = new Map(shots.map((shot) => [shot.i, shot]));
  const total = Math.max(vehicle.marks.length, shots.length);
  for (let i = 0; i < total; i += 1) {
    const shot = known.get(i) || { i, attempts: [], accepted: null };
    out[standing(vehicle, shot)] += 1;
  }
  return { ...out, total };
}

/* The state in one word with its colour, and why it is not simply going well. */
export function headline(summary, link = { up: true }) {
  const state = summary.state;
  if (summary.status === "offline") return { word: "Offline", kind: "bad", reason: "The vehicle's daemon has left the broker." };
  if (!state) return { word: link.up ? "Waiting" : "No broker", kind: link.up ? "" : "bad", reason: link.up ? "Nothing was heard from this vehicle yet." : link.reason };
  const [word, kind] = STATES[state.state] || [String(state.state), ""];
  const lights = Object.entries(state.link || {}).filter(([, one]) => !one.ok).map(([name]) => name);
  const missing = lights.length ? `No contact to ${lights.join(", ")}.` : "";
  if (state.state === "idle" && state.resumable) return { word: "Interrupted", kind: "warn", reason: "A mission was interrupted. Resume it, or abort it for good." };
  if (state.state === "idle" && missing) return { word: "Not ready", kind: "warn", reason: missing };
  return { word, kind: missing && kind !== "bad" ? "warn" : kind, reason: sentence(state.reason) || missing };
}
export function sentence(text) {
  if (!text) return "";
  const whole = text[0].toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
export function light(name, one) {
  if (!one || one.age_s === null) return { ok: false, text: `${name}: nothing was heard from it yet` };
  const age = one.age_s < 1 ? "less than a second" : `${Math.round(one.age_s)} s`;
  return { ok: one.ok, text: `${name}: ${one.ok ? "connected" : "lost"}, last heard ${age} before the last state` };
}
export const clock = (seconds) => {
  if (typeof seconds !== "number" || !Number.isFinite(seconds)) return "–";
  const whole = Math.max(0, Math.round(seconds)), hours = Math.floor(whole / 3600);
  const text = `${hours ? String(Math.floor((whole % 3600) / 60)).padStart(2, "0") : Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
  return hours ? `${hours}:${text}` : text;
};
/* Who needs somebody comes first: lost or failing, then paused, then flying, then the rest. */
export function urgency(summary) {
  const { kind } = headline(summary);
  return kind === "bad" ? 0 : kind === "warn" ? 1 : flying(summary.state) ? 2 : 3;
}

/* What to do about the guard that holds the mission; `code` is that of the pause. */
const ADVICE = {
  link: "Wait: the mission continues when the autopilot is heard again.",
  attitude: "Wait: the mission continues when the gimbal reports its attitude again. If it does not, look at its power and cable.",
  gimbal_control: "Another station steers the gimbal. Release it there, then resume here.",
  gimbal_unknown: "Wait a few seconds: the gimbal's manager is being asked.",
  gimbal_lost: "Wait: the gimbal is being taken again.",
  pilot: "The pilot flies. When the pilot has handed over, resume here.",
  turning: "Set a flight mode in which the vehicle may turn, for example GUIDED; the mission continues by itself.",
  landed: "The vehicle is on the ground. Take off and hover where the mission began, then resume.",
  battery: "Land, swap the battery, take off to the same place, then resume: photos that were taken stay.",
  position: "Fly the vehicle back to where the mission began; the mission continues by itself.",
  fix: "Wait until the position is reliable again, away from what shades the sky.",
  storage: "Free some space on the camera's card; the mission continues by itself.",
  camera: "Look at the camera: power, card, mode. Then resume.",
  command: "Resume when you are ready.",
};
export function advice(vehicle) {
  if (!vehicle.state || vehicle.state.state !== "paused") return "";
  const events = vehicle.mission ? vehicle.mission.events : [];
  const pause = [...events].reverse().find((event) => event.kind === "mission_paused");
  return (pause && (ADVICE[pause.code] || (pause.automatic ? "Wait: the mission continues by itself when the cause is gone." : ""))) || "Resume when the cause is gone.";
}
