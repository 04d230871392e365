/* Evaluated in a page by accessibility.py: one line for each problem of what is shown now. */
(() => {
  const found = [], bad = (node, why) => found.push(`${node.tagName.toLowerCase()}${node.id ? "#" + node.id : ""}.${String(node.className.baseVal ?? node.className).split(" ")[0]} "${(node.textContent || "").trim().slice(0, 30)}": ${why}`);
  const seen = (node) => node.getClientRects().length > 0 && getComputedStyle(node).visibility !== "hidden";
  const open = document.querySelector("dialog[open]"), root = open || document.body;
  const all = [...root.querySelectorAll("*")].filter((node) => seen(node) && !node.closest(".skip, noscript"));
  const numbers = (text) => (text.match(/[\d.]+/g) || [0, 0, 0, 0]).map(Number);
  const parse = (text) => {
    if (text.startsWith("color(srgb")) { const [r, g, b, a = 1] = numbers(text.slice(10)); return [255 * r, 255 * g, 255 * b, a]; }
    const [r, g, b, a = 1] = numbers(text); return [r, g, b, a];
  };
  const over = (top, below) => [0, 1, 2].map((k) => top[k] * top[3] + below[k] * (1 - top[3]));
  const ground = (node) => {
    const layers = [];
    for (let at = node; at; at = at.parentElement) layers.push(parse(getComputedStyle(at).backgroundColor));
    let colour = [255, 255, 255];
    for (const layer of layers.reverse()) colour = over(layer, colour);
    return colour;
  };
  const luminance = (c) => c.slice(0, 3).map((v) => v / 255).map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const named = (node) => {
    const by = node.getAttribute("aria-labelledby");
    const label = node.id && document.querySelector(`label[for="${CSS.escape(node.id)}"]`);
    return (node.getAttribute("aria-label") || (by && by.split(" ").map((id) => document.getElementById(id)?.textContent || "").join(" ")) || label?.textContent || node.textContent || node.getAttribute("alt") || node.getAttribute("title") || "").trim();
  };
  for (const node of all) {
    const style = getComputedStyle(node), role = node.getAttribute("role");
    const acts = node.matches("button, a[href], input, select, textarea, summary, canvas[tabindex], [role=button]");
    if ((acts || role === "img" || role === "application" || node.matches("dialog, iframe, ol[tabindex]")) && !named(node)) bad(node, "has no name");
    if (node.matches("img") && !node.hasAttribute("alt")) bad(node, "has no alt text");
    if (acts && !node.matches("p a, li span a, canvas")) {
      const box = node.getBoundingClientRect();
      if (box.width < 43.9 || box.height < 43.9) bad(node, `is a target of ${box.width.toFixed(0)} × ${box.height.toFixed(0)} px`);
    }
    const text = [...node.childNodes].some((child) => child.nodeType === 3 && child.data.trim());
    if (text && !node.closest("svg")) {
      const size = parseFloat(style.fontSize);
      if (size < 16) bad(node, `has text of ${size} px`);
      if (!node.closest("[aria-disabled=true], :disabled, .stale") && parseFloat(style.opacity) === 1) {
        const below = ground(node), colour = over(parse(style.color), below), a = luminance(colour), b = luminance(below);
        const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 600);
        if (ratio < (large ? 3 : 4.5)) bad(node, `has a contrast of ${ratio.toFixed(2)}`);
      }
    }
    for (const name of ["aria-labelledby", "aria-describedby", "for"]) for (const id of (node.getAttribute(name) || "").split(" ").filter(Boolean)) if (!document.getElementById(id)) bad(node, `${name} names ${id}, which is not there`);
  }
  const ids = [...document.querySelectorAll("[id]")].map((node) => node.id);
  for (const id of new Set(ids.filter((one, k) => ids.indexOf(one) !== k))) found.push(`the id ${id} is there twice`);
  if (!document.documentElement.lang) found.push("the page has no language");
  if (!document.title) found.push("the page has no title");
  if (document.querySelectorAll("main").length !== 1) found.push("there is not one main element");
  if (document.querySelectorAll("h1").length !== 1) found.push(`there are ${document.querySelectorAll("h1").length} headings of the first level`);
  if (document.documentElement.scrollWidth > window.innerWidth) found.push(`the page is ${document.documentElement.scrollWidth} px wide on ${window.innerWidth}`);
  return found;
})()
