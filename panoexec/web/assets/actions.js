/* What can be commanded now: one obvious next step, the rest, and why something cannot be done. Pure. */
import { flying } from "./model.js";

const QUESTIONS = {
  abort: (n) => ({ title: "Abort the mission?", text: `It ends for good and cannot be resumed. ${n === 1 ? "1 photo stays" : `${n} photos stay`}.`, yes: "Abort", kind: "bad" }),
  finish: (n, gaps) => ({ title: "Finish with gaps?", text: `Shooting ends and ${gaps === 1 ? "1 missing shot is" : `${gaps} missing shots are`} accepted. ${n === 1 ? "1 photo is" : `${n} photos are`} kept; the panorama has gaps. It cannot be resumed.`, yes: "Finish", kind: "warn" }),
};

/* Args: vehicle of the model, role, lost (no server). Returns {primary, others, abort}; each {command, label, reason, question, key}. */
export function actions(vehicle, role, lost) {
  const state = vehicle.state || {}, may = vehicle.may || {}, now = state.state, done = state.shots_done || 0;
  const gaps = Math.max(0, (state.shots_total || 0) - done);
  const blocked = lost ? "no connection to the server" : role === "viewer" ? "you are logged in as a viewer, who commands nothing" : "";
  const action = (command, label, key, more = {}) => {
    const question = QUESTIONS[command] ? QUESTIONS[command](done, gaps) : null;
    return { command, label, key, reason: blocked || (may[command] ?? ""), question, fields: {}, ...more };
  };
  const plan = action("open-plan", "Plan", "n", { reason: lost ? blocked : flying(state) ? "a mission is under way" : "" });
  const pause = action("pause", "Pause", "p"), resume = action("resume", "Resume", "p"), finish = action("finish", "Finish", "f");
  const abort = action("abort", "Abort", "x");
  const result = action("open-result", "Open result", "o", { reason: state.mission_id ? "" : "there is no mission yet" });
  if (flying(state)) {
    const next = now === "paused" ? resume : pause;
    return { primary: next, others: [finish], abort };
  }
  if (now === "idle" && state.resumable) return { primary: resume, others: [plan], abort };
  if (["complete", "incomplete", "aborted", "failed"].includes(now)) return { primary: result, others: [plan, ...(state.resumable ? [resume] : [])], abort: null };
  return { primary: plan, others: [], abort: null };
}

/* What can be done with one shot. */
export function shotActions(vehicle, shot, role, lost) {
  const may = vehicle.may || {}, letter = vehicle.marks[shot.i];
  const blocked = lost ? "no connection to the server" : role === "viewer" ? "you are logged in as a viewer, who commands nothing" : "";
  const skip = blocked || may.skip || ("dr".includes(letter || "-") ? "it is done" : letter === "m" ? "it is given up already" : "");
  const repeat = blocked || may.repeat || (letter === "t" ? "it was not taken yet" : letter === "c" ? "it is being taken" : "");
  return [
    { command: "repeat", label: "Repeat", key: "r", reason: repeat, fields: { shot: shot.i } },
    { command: "skip", label: "Skip", key: "s", reason: skip, fields: { shot: shot.i } },
  ];
}

/* The words of a command's stage. */
export function stageText(entry) {
  const words = { sent: "sent", received: "received", done: "done", refused: "refused", failed: "failed" };
  const why = entry.error ? `: ${entry.error.message || entry.error.code || entry.error}` : "";
  return `${words[entry.stage] || entry.stage}${why}`;
}
export function entryText(entry) {
  const shot = entry.fields && Number.isInteger(entry.fields.shot) ? ` shot ${entry.fields.shot}` : "";
  return `${entry.command}${shot}`;
}
