/* Questions, help and short notes. */
import { el } from "/assets/pages/elements.js";

/* Asks once; resolves to whether yes was chosen. The answer that loses nothing has the focus. */
export function ask({ title, text, yes, kind = "bad" }) {
  return new Promise((resolve) => {
    const no = el("button", { class: "plain big", value: "no" }, "Cancel");
    const box = el("dialog", { "aria-labelledby": "question", "aria-describedby": "question-text" },
      el("form", { method: "dialog" }, el("h2", { id: "question" }, title), el("p", { id: "question-text" }, text),
        el("div", { class: "row" }, no, el("button", { class: `big solid ${kind}`, value: "yes", id: "answer-yes" }, yes))));
    box.addEventListener("close", () => { box.remove(); resolve(box.returnValue === "yes"); });
    document.body.append(box);
    box.showModal();
    no.focus();
  });
}

const KEYS = [
  ["n", "plan a mission"], ["p", "pause or resume"], ["f", "finish with gaps (asks)"], ["x", "abort (asks)"], ["o", "open the result"],
  ["j, k", "next, previous shot"], ["r", "repeat the selected shot"], ["s", "skip the selected shot"], ["Esc", "let go of the selected shot"],
  ["m", "sphere or flat map"], ["arrow keys, +, \u2212", "turn and zoom the map that has the focus"], ["v", "all vehicles"], ["?", "this list"],
];
export function help() {
  if (document.getElementById("help")) return;
  const close = el("button", { class: "big solid" }, "Close");
  const box = el("dialog", { id: "help", "aria-labelledby": "help-title" }, el("form", { method: "dialog" }, el("h2", { id: "help-title" }, "Keys"),
    el("dl", { class: "keys" }, KEYS.map(([key, text]) => [el("dt", {}, el("kbd", {}, key)), el("dd", {}, text)])), el("div", { class: "row" }, close)));
  box.addEventListener("close", () => box.remove());
  document.body.append(box);
  box.showModal();
  close.focus();
}

/* A note that goes away by itself; the same `key` replaces its former text. */
const notes = new Map();
export function toast(key, text, kind = "") {
  let note = notes.get(key);
  if (!note) {
    note = { node: el("div", { class: "toast" }) };
    notes.set(key, note);
    document.getElementById("toasts").append(note.node);
  }
  note.node.textContent = text;
  note.node.className = `toast ${kind}`;
  clearTimeout(note.timer);
  note.timer = setTimeout(() => { note.node.remove(); notes.delete(key); }, kind === "bad" ? 9000 : 3500);
}
