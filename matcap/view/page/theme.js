// Light or dark theme: the system's, until the button changes it.

import { $ } from "./controls.js";

export function followTheme(changed) {
  const { dataset } = document.documentElement;
  dataset.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  $("theme").addEventListener("click", () => {
    dataset.theme = dataset.theme === "light" ? "dark" : "light";
    changed();
  });
}

// Background colour, components from 0 to 1.
export function dressed() {
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
}
