// The view's state in the address's fragment, for reloads, bookmarks and links. Only differences
// from the initial state are stored; invalid entries are ignored.

import { adjustmentsText, parseAdjustments } from "./adjust.js";

const WORDS = ["shape", "map", "light", "left", "right"];
const NUMBERS = ["x", "y", "span", "exposure", "seed", "share"];

export function toAddress(state, initial) {
  const entries = new URLSearchParams();
  for (const name of [...WORDS, ...NUMBERS]) {
    if (state[name] !== initial[name]) {
      entries.set(name, typeof state[name] === "number" ? Number(state[name].toPrecision(12)) : state[name]);
    }
  }
  if (String(state.lamp) !== String(initial.lamp)) {
    entries.set("lamp", state.lamp.map((value) => Number(value.toFixed(3))).join(" "));
  }
  const adjust = adjustmentsText(state.adjust);
  if (adjust !== adjustmentsText(initial.adjust)) entries.set("adjust", adjust || "none");
  return entries.toString();
}

export function fromAddress(text, initial, choices) {
  const entries = new URLSearchParams(text), found = {};
  for (const name of WORDS) {
    if (entries.has(name) && choices[name].includes(entries.get(name))) found[name] = entries.get(name);
  }
  for (const name of NUMBERS) {
    const value = Number(entries.get(name));
    if (entries.has(name) && Number.isFinite(value) && Math.abs(value) <= 2 ** 53) found[name] = value;
  }
  if (found.share !== undefined) found.share = Math.min(Math.max(found.share, 0), 1);
  if (found.seed !== undefined && !Number.isSafeInteger(found.seed)) delete found.seed;
  const lamp = (entries.get("lamp") || "").split(" ").map(Number);
  if (lamp.length === 3 && lamp.every(Number.isFinite) && lamp[2] > 0) found.lamp = lamp;
  if (entries.has("adjust")) found.adjust = parseAdjustments(entries.get("adjust"));
  return { ...initial, ...found };
}
