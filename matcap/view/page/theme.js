// Light or dark: as the system has it, until the button says otherwise.

import { $ } from "./controls.js";

export function followTheme(changed) {
  const { dataset } = document.documentElement;
  dataset.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  $("theme").addEventListener("click", () => {
    dataset.theme = dataset.theme === "light" ? "dark" : "light";
    changed();
  });
}

// The colour that lies where there is nothing, from 0 to 1.
export function dressed() {
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
}
