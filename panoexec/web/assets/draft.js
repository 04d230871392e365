/* What is asked of a plan, and what an answer says of it. Pure: no element of the page. */
import { RAD, wrap } from "/assets/pages/sphere_math.js";

export const LEAST_DEG = 5;

export function draftOf(plan) {
  const { elevation_deg: elevation, azimuth_deg: azimuth, overlap_h, overlap_v } = plan.constraints;
  return { camera: "", overlap: overlap_h === overlap_v ? overlap_h : Math.max(overlap_h, overlap_v), elevation: [...elevation], azimuth: [...azimuth] };
}
export const isCircle = (azimuth) => azimuth[1] - azimuth[0] >= 360 - 1e-9;
/* The fields of a request. A preset says what the form does not show (reference, tolerances, …); the form wins. */
export const fieldsOf = (draft) => ({
  ...(draft.preset ? { preset: draft.preset } : {}), ...(draft.camera ? { camera: draft.camera } : {}), ...(draft.ownOverlap === false ? {} : { overlap: draft.overlap }),
  elevation_deg: [...draft.elevation], azimuth_deg: [...draft.azimuth],
});
/* The draft that a preset asks for, beside what it leaves open. */
export function presetDraft(draft, { preset, fields }) {
  const { camera, overlap, overlap_h, overlap_v } = fields, both = [overlap_h, overlap_v].filter((one) => typeof one === "number");
  return {
    preset, camera: typeof camera === "string" ? camera : "", overlap: overlap ?? (both.length ? Math.max(...both) : draft.overlap), ownOverlap: both.length === 0,
    elevation: [...(fields.elevation_deg || draft.elevation)], azimuth: [...(fields.azimuth_deg || draft.azimuth)],
  };
}
export const sameDraft = (a, b) => JSON.stringify(fieldsOf(a)) === JSON.stringify(fieldsOf(b));

/* Why the draft cannot be planned, by field; empty if it can. */
export function faults(draft) {
  const out = {}, [low, high] = draft.elevation, [left, right] = draft.azimuth;
  if (!(low >= -90 && low <= 90)) out.low = "must be −90° to 90°";
  if (!(high >= -90 && high <= 90)) out.high = "must be −90° to 90°";
  if (!out.low && !out.high && !(high > low)) out.high = "must be above the lower edge";
  if (!Number.isFinite(left)) out.left = "must be a number";
  if (!Number.isFinite(right)) out.right = "must be a number";
  if (!out.left && !out.right && !(right > left && right - left <= 360 && left >= -360 && right <= 540)) out.right = "must be clockwise of the left edge, by at most 360°";
  if (!(draft.overlap >= 0 && draft.overlap < 1)) out.overlap = "must be 0 % to 99 %";
  return out;
}

/* Moves one edge of the band to a direction; whole degrees. */
export function dragged(draft, edge, elevation, azimuth) {
  const next = { ...draft, elevation: [...draft.elevation], azimuth: [...draft.azimuth] };
  const level = Math.max(-90, Math.min(90, Math.round(elevation)));
  const positive = (angle) => ((angle % 360) + 360) % 360;
  if (edge === "high") next.elevation[1] = Math.max(level, draft.elevation[0] + LEAST_DEG);
  if (edge === "low") next.elevation[0] = Math.min(level, draft.elevation[1] - LEAST_DEG);
  if (edge === "right") {
    const span = Math.round(positive(azimuth - draft.azimuth[0]));
    next.azimuth[1] = draft.azimuth[0] + Math.min(355, Math.max(LEAST_DEG, span));
  }
  if (edge === "left") {
    const span = Math.min(355, Math.max(LEAST_DEG, Math.round(positive(draft.azimuth[1] - azimuth))));
    const right = wrap(draft.azimuth[1]);
    const left = wrap(right - span);
    next.azimuth = [left, left + span];
  }
  return next;
}
/* Where the handles are: those of the upper and lower edge stand in the middle of the sector, or where one looks. */
export function handles(draft, yaw) {
  const circle = isCircle(draft.azimuth), middle = circle ? yaw : draft.azimuth[0] + (draft.azimuth[1] - draft.azimuth[0]) / 2;
  const level = (draft.elevation[0] + draft.elevation[1]) / 2;
  const out = [["high", Math.min(88, draft.elevation[1]), middle], ["low", Math.max(-88, draft.elevation[0]), middle]];
  if (!circle) out.push(["left", level, draft.azimuth[0]], ["right", level, draft.azimuth[1]]);
  return out.map(([edge, elevation, azimuth]) => ({ edge, elevation, azimuth: wrap(azimuth) }));
}

const share = (draft) => (Math.sin(draft.elevation[1] * RAD) - Math.sin(draft.elevation[0] * RAD)) * Math.min(360, draft.azimuth[1] - draft.azimuth[0]);
/* About how many images and seconds the draft takes, from a plan for another one: until the vehicle has answered. */
export function guess(draft, known) {
  if (!known || !(share(known.draft) > 0)) return null;
  const factor = (share(draft) / share(known.draft)) * ((1 - known.draft.overlap) / (1 - draft.overlap)) ** 1.5;
  return { images: Math.max(1, Math.round(known.images * factor)), duration_s: known.duration_s * factor };
}

/* A plan file as a mission of the map. */
export function missionOf(plan) {
  const { camera, constraints } = plan;
  return {
    id: null, name: "", events: [], content: null, gap: false,
    camera: { name: camera.name, half_width: Math.tan((camera.hfov_deg * Math.PI) / 360), half_height: Math.tan((camera.vfov_deg * Math.PI) / 360), hfov_deg: camera.hfov_deg, vfov_deg: camera.vfov_deg },
    band: { known: true, elevation: constraints.elevation_deg, azimuth: constraints.azimuth_deg, masks: [] }, tolerance_deg: constraints.tolerance_deg,
    shots: plan.shots.map((shot) => ({ i: shot.index, row: shot.row, patch: false, target: [shot.pitch_deg, shot.yaw_deg], q: levelQuaternion(shot.pitch_deg, shot.yaw_deg), accepted: null, reason: "", url: null, attempts: [] })),
  };
}
export function levelQuaternion(pitch, yaw) {
  const cy = Math.cos((yaw * RAD) / 2), sy = Math.sin((yaw * RAD) / 2), cp = Math.cos((pitch * RAD) / 2), sp = Math.sin((pitch * RAD) / 2);
  return [cp * cy, -sp * sy, sp * cy, cp * sy];
}

/* The certificate in one line: {ok, text}. */
export function certificateLine(answer) {
  const { certificate, plan } = answer;
  if (!certificate) return { ok: false, text: "not proven complete" };
  const tau = plan ? plan.constraints.tolerance_deg : null;
  const within = tau ? `within ${tau.pitch}° in pitch, ${tau.roll}° in roll and ${tau.yaw}° in yaw` : "within the tolerances";
  if (certificate.certified) return { ok: true, text: `Complete for every pointing error ${within}.` };
  return { ok: false, text: certificate.failures && certificate.failures.length ? certificate.failures.slice(0, 2).join("; ") : "Not proven complete." };
}
/* Why the mission cannot be started; "" if it can. Nothing is started that was not shown. */
export function startReason({ answer, draft, asking, may, role, lost }) {
  if (lost) return "no connection to the server";
  if (role === "viewer") return "you are logged in as a viewer, who commands nothing";
  if (may) return may;
  if (Object.keys(faults(draft)).length) return "the numbers above make no plan";
  if (asking) return "the plan is being computed";
  if (!answer || !answer.ok) return "there is no plan";
  if (!sameDraft(answer.draft, draft)) return "the plan is being computed";
  return "";
}
