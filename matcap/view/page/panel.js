// Shows the state in text and on the controls.

import { $, CHOICES, number, option, showSlider } from "./controls.js";

const SCALE = 190; // pixels that the scale is long at most

export function describe(about) {
  $("name").textContent = about.name;
  const [wide, tall] = about.period || [];
  $("what").textContent = about.period ? `repeats every ${wide} × ${tall} texels`
    : "endless: it never repeats";
  // A map set and an enclosed tile have only one realisation.
  $("seed-row").hidden = about.period !== null;
  if (about.second) {
    $("share-row").hidden = false;
    $("share-label").textContent = `Blend with ${about.second}`;
  }
}

// A length in texels as text.
export function length(view, texels) {
  const millimetres = view.about.millimetres * (view.texelSize || view.about.texel_size) * texels;
  if (!millimetres) return `${number(texels)} texels`;
  if (millimetres < 10) return `${number(millimetres)} mm`;
  return millimetres < 1000 ? `${number(millimetres / 10)} cm` : `${number(millimetres / 1000)} m`;
}

export function legend(view) {
  const { map, light, span, shape } = view.state;
  const [low, high] = view.range().map((value) => number(value));
  const said = {
    lit: { point: "point light", studio: "a studio: two soft lamps",
      window: "a window on the left", dusk: "a low sun" }[light],
    diffuse: "diffuse albedo, sRGB",
    specular: `specular albedo F0, black ${low} to white ${high}`,
    roughness: `roughness, black ${low} to white ${high}`,
    height: `height, black ${low} to white ${high} plane units`,
    normal: "normal, +x right in red, +y up in green",
  }[map];
  return `${said} · ${number(span, 4)} texels ${shape === "plane" ? "across" : "in diameter"}`;
}

export function whereabouts(view) {
  const { shape, x, y } = view.state;
  return shape === "plane" ? `, at ${Math.round(x)}, ${Math.round(y)}` : "";
}

// A length of 1, 2 or 5 times a power of ten.
export function showScale(view) {
  const { canvas, state } = view, size = view.texelSize || view.about.texel_size;
  const unit = view.about.millimetres ? view.about.millimetres * size : 1;
  const texels = (state.span * SCALE) / Math.max(canvas.clientWidth, canvas.clientHeight);
  const ten = 10 ** Math.floor(Math.log10(texels * unit));
  const step = [5, 2, 1].find((one) => one * ten <= texels * unit) * ten;
  $("scale").style.width = `${(step / (texels * unit)) * SCALE}px`;
  $("scale").textContent = state.shape === "plane" ? length(view, step / unit) : "";
}

export function showState(view) {
  const { state } = view;
  for (const name of Object.keys(CHOICES)) option(name, state[name]).checked = true;
  showSlider("exposure", state.exposure);
  showSlider("lift", state.lamp[2]);
  $("lift-row").hidden = state.light !== "point";
  showSlider("share", state.share);
  if (document.activeElement !== $("seed")) $("seed").value = state.seed;
  showWipe(view);
}

// The wipe with the labels of its sides.
export function showWipe(view) {
  const { state, canvas } = view;
  $("wipe").hidden = !view.wiped;
  if (!view.wiped) return;
  const at = state.wipe * canvas.clientWidth;
  $("wipe").style.left = `${at}px`;
  $("wipe").setAttribute("aria-valuenow", String(Math.round(100 * state.wipe)));
  $("wipe").setAttribute("aria-valuetext",
    `${sideOf(view, state.left)} to the left, ${sideOf(view, "field")} to the right`);
  $("wipe-left").textContent = sideOf(view, state.left);
  $("wipe-right").textContent = sideOf(view, "field");
}

function sideOf({ state, about }, side) {
  return {
    photo: "photograph",
    second: about.second,
    field: state.share > 0 ? "blend" : state.left === "second" ? about.name
      : about.period ? "repeated" : "endless",
  }[side];
}
