/* The page: routes, the top, the connection to the server, keys. */
import { el } from "/assets/pages/elements.js";
import { help, toast } from "./dialogs.js";
import { Link } from "./link.js";
import { newModel } from "./model.js";
import { redraw, timeOf } from "./render.js";
import { VehicleView } from "./vehicle.js";

const errors = [];
window.addEventListener("error", (event) => {
  errors.push(String(event.message));
  document.documentElement.dataset.errors = errors.join(" | ");
});
window.addEventListener("unhandledrejection", (event) => {
  errors.push(String(event.reason));
  document.documentElement.dataset.errors = errors.join(" | ");
});

const top = document.getElementById("top"), holder = document.getElementById("view"), lostBar = document.getElementById("lost");
const model = newModel(), page = { model, go };
const changes = new Set();
let view = null, route = null, alone = true;

const link = new Link(model, (names, message) => {
  for (const name of names) changes.add(name);
  if (message && message.type === "answer" && message.stage !== "sent") told(message);
  // what is old looks old at once: a busy computer makes frames rare
  if (changes.has("lost")) draw();
  if (!page.waiting && changes.size) {
    page.waiting = true;
    // a hidden page gets no frames, and shall still be right when it is looked at
    (document.hidden ? (f) => setTimeout(f, 200) : requestAnimationFrame)(() => { page.waiting = false; draw(); });
  }
});
page.link = link;

function told(answer) {
  if (answer.command === "plan") return;
  const kind = answer.stage === "done" ? "good" : answer.stage === "received" ? "" : "bad";
  const why = answer.error ? `: ${answer.error.message || answer.error.code || answer.error}` : "";
  toast("command", `${answer.command}: ${answer.stage}${why}`, kind);
}

function where() {
  const found = /^\/v\/([A-Za-z0-9_-]{1,64})\/?$/.exec(location.pathname), hash = location.hash.slice(1);
  const [name, value] = hash.split("=");
  return { vehicle: found ? found[1] : null, part: ["plan", "missions", "mission"].includes(name) ? name : "", value: value ? decodeURIComponent(value) : "" };
}
function go(address) {
  alone = false;
  history.pushState(null, "", address);
  show();
}
const VIEWS = {
  plan: () => import("./planning.js").then(({ PlanView }) => new PlanView(page, route.vehicle)),
  missions: () => import("./library.js").then(({ LibraryView }) => new LibraryView(page, route.vehicle)),
  mission: () => import("./library.js").then(({ MissionView }) => new MissionView(page, route.vehicle, route.value)),
  fleet: () => import("./fleet.js").then(({ FleetView }) => new FleetView(page)),
};
async function show() {
  const before = route;
  route = where();
  const mine = route;
  if (!before || before.vehicle !== route.vehicle || link.following !== route.vehicle) link.follow(route.vehicle);
  if (view && view.close) view.close();
  const part = route.part || (route.vehicle ? "" : "fleet");
  const next = part ? await VIEWS[part]() : new VehicleView(page, route.vehicle);
  if (route !== mine) return;
  view = next;
  holder.replaceChildren(view.node);
  if (before) holder.focus({ preventScroll: true });
  window.scrollTo(0, 0);
  changes.add("vehicle");
  draw();
}
function drawTop() {
  const { hello } = model, tabs = route.vehicle ? [["Live", ""], ["Plan", "#plan"], ["Missions", "#missions"]].map(([text, hash]) => [text, `/v/${route.vehicle}${hash}`, hash.slice(1) === (route.part === "mission" ? "missions" : route.part)]) : [["Vehicles", "/", route.part === ""], ["Missions", "/#missions", route.part !== ""]];
  redraw(top, [hello && [hello.user, hello.name, hello.role, hello.login], tabs, model.vehicles.size], () => [
    el("a", { class: "brand", href: "/", "data-nav": "/#", "aria-label": "panoexec: all vehicles" }, el("img", { src: "/assets/icon.svg", alt: "", width: 26, height: 26 }), el("span", {}, "panoexec")),
    el("nav", { class: "tabs", "aria-label": "Pages" }, tabs.map(([text, address, on]) => el("a", { href: address, "data-key": text, "data-nav": address, "aria-current": on ? "page" : null }, text))),
    el("div", { class: "who" }, hello ? el("button", { class: "plain name", "data-key": "who", "aria-label": `You are ${hello.user || hello.name}, ${hello.role}: change`, onclick: rename }, `${hello.user || link.name || hello.name}${hello.role === "viewer" ? " (viewer)" : ""}`) : null,
      hello && hello.login ? el("form", { method: "post", action: "/logout" }, el("button", { class: "plain" }, "Log out")) : null,
      el("button", { class: "plain", "data-key": "help", "aria-label": "Keys and help", onclick: help }, "?")),
  ]);
}
function rename() {
  if (model.hello.user) { toast("who", `Logged in as ${model.hello.user}, ${model.hello.role}.`); return; }
  const field = el("input", { type: "text", maxlength: 40, id: "own-name", value: link.name || model.hello.name });
  const box = el("dialog", { "aria-labelledby": "own-title" }, el("form", { method: "dialog" }, el("h2", { id: "own-title" }, "Your name in the log"), el("p", {}, "Others see who commanded what."), el("label", { for: "own-name", class: "small" }, "Name"), field,
    el("div", { class: "row" }, el("button", { class: "plain big", value: "no", formnovalidate: true }, "Cancel"), el("button", { class: "solid big", value: "yes" }, "Save"))));
  box.addEventListener("close", () => {
    box.remove();
    if (box.returnValue !== "yes" || !field.value.trim()) return;
    link.rename(field.value.trim());
    localStorage.setItem("panoexec-name", field.value.trim());
    changes.add("hello");
    draw();
  });
  document.body.append(box);
  box.showModal();
  field.select();
}
function draw() {
  const lost = model.lostSince !== null;
  document.body.classList.toggle("lost", lost);
  lostBar.hidden = !lost;
  if (lost) {
    const text = `No connection to the server since ${timeOf(model.lostSince)}. What you see is old.`;
    if (lostBar.textContent !== text) lostBar.textContent = text;
  }
  if (!route) return;
  if (!route.vehicle && !route.part && alone && model.vehicles.size === 1 && location.hash === "") {
    history.replaceState(null, "", `/v/${model.vehicles.keys().next().value}`);
    alone = false;
    show();
    return;
  }
  if (model.problem) { toast("problem", model.problem, "bad"); model.problem = ""; }
  const now = new Set(changes);
  changes.clear();
  if (view) {
    view.update(now);
    document.title = view.title ? `${view.title} · panoexec` : "panoexec";
  }
  drawTop();
  Object.assign(document.documentElement.dataset, { ready: model.hello ? "yes" : "no", lost: lost ? "yes" : "no", view: route.part || (route.vehicle ? "live" : "fleet") });
  if (model.hello && !performance.getEntriesByName("first-view").length && (!route.vehicle || model.vehicle)) performance.mark("first-view");
}

document.addEventListener("click", (event) => {
  const anchor = (event.target.closest ? event.target : document.body).closest("a[data-nav]");
  if (!anchor || event.ctrlKey || event.metaKey || event.shiftKey || event.button) return;
  event.preventDefault();
  go(anchor.dataset.nav);
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]") || (event.target.closest && event.target.closest("input, select, textarea"))) return;
  if (event.key === "?") help();
  else if (event.key === "v") go("/#");
  else if (!(view && view.key && view.key(event.key))) return;
  event.preventDefault();
});
window.addEventListener("popstate", show);
const kept = localStorage.getItem("panoexec-name");
if (kept) link.name = kept;
show();
