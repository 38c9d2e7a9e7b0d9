// Controls: pointer, touch and keys to the view's state, and its state to words.

import { EnclosedPages, ServedPages } from "./source.js";
import { roomRadiance } from "./surroundings.js";
import { FLASH, MAPS, View } from "./view.js";

(() => {
  const about = JSON.parse(document.getElementById("about").textContent);
  const $ = (id) => document.getElementById(id);
  const canvas = $("canvas");

  $("name").textContent = about.name;
  $("what").textContent = about.period
    ? `repeats every ${about.period[0]} × ${about.period[1]} texels`
    : "endless: it never repeats";
  if (about.photo) {
    const kind = about.photo_is_sheet ? "capture sheet" : "photograph";
    $("photo").src = about.photo;
    $("photo").alt = `The ${kind} of ${about.name}`;
    $("photo-caption").textContent = kind;
    $("with-photo").textContent = kind[0].toUpperCase() + kind.slice(1);
    $("with-photo").hidden = false;
  }
  // A map set and an enclosed tile have one realisation.
  $("seed-row").hidden = about.period !== null;
  if (about.second) {
    $("share-row").hidden = false;
    $("share-label").textContent = `Blend with ${about.second}`;
  }

  const trouble = (words) => {
    $("trouble").textContent = words;
    $("trouble").hidden = false;
  };
  let view;
  try {
    view = new View(canvas, about, about.tile ? new EnclosedPages(about) : new ServedPages(about));
  } catch (error) {
    trouble(error.message === "no WebGL2"
      ? "This browser gives no WebGL2, which the page draws with. Switch hardware acceleration on, "
        + "try another browser, or use matcap relight."
      : `The page cannot draw: ${error.message}`);
    return;
  }
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    trouble("The graphics driver has stopped. Reload the page.");
  });

  // --- size -------------------------------------------------------------------------------------
  const fit = () => {
    const ratio = Math.min(devicePixelRatio, 2);
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    view.redraw();
  };
  new ResizeObserver(fit).observe(canvas);

  // --- words ------------------------------------------------------------------------------------
  const number = (value, digits = 3) => Number(value.toPrecision(digits)).toString();
  const legend = () => {
    const { map, light, span, shape, x, y } = view.state;
    const [low, high] = view.range().map((value) => number(value));
    const said = {
      lit: light === "point" ? "point light" : "a made-up room: two soft lamps, dim below",
      diffuse: "diffuse albedo, sRGB",
      specular: `specular albedo F0, black ${low} to white ${high}`,
      roughness: `roughness, black ${low} to white ${high}`,
      height: `height, black ${low} to white ${high} plane units`,
      normal: "normal, +x right in red, +y up in green",
    }[map];
    const where = shape === "plane"
      ? `${Math.round(span)} texels across, at ${Math.round(x)}, ${Math.round(y)}`
      : `${Math.round(span)} texels in diameter`;
    return `${said} · ${where}`;
  };
  view.changed = () => {
    $("legend").textContent = legend();
    const left = view.missing().length;
    $("status").textContent = view.failure
      || (left ? `sharpening: ${left} piece${left > 1 ? "s" : ""} to come` : "");
    canvas.setAttribute("aria-label",
      `${about.name} on a ${view.state.shape}: ${legend()}${left ? ", still sharpening" : ""}`);
  };
  const show = () => {
    const { state } = view;
    for (const group of ["shape", "light", "map"]) {
      const name = group === "shape" ? "surface" : group;
      document.querySelector(`input[name=${name}][value=${state[group]}]`).checked = true;
    }
    $("exposure").value = state.exposure;
    $("exposure-value").textContent = `${state.exposure > 0 ? "+" : ""}${state.exposure} stops`;
    $("lift").value = state.lamp[2];
    $("lift-value").textContent = number(state.lamp[2], 2);
    $("lift-row").hidden = state.light !== "point";
    $("share").value = state.share;
    $("share-value").textContent = number(state.share, 2);
    if (document.activeElement !== $("seed")) $("seed").value = state.seed;
  };
  const set = (changes) => {
    view.set(changes);
    show();
  };

  // --- controls ---------------------------------------------------------------------------------
  for (const [name, key] of [["surface", "shape"], ["light", "light"], ["map", "map"]]) {
    for (const input of document.querySelectorAll(`input[name=${name}]`)) {
      input.addEventListener("change", () => set({ [key]: input.value }));
    }
  }
  const expose = (value) => set({ exposure: Math.min(4, Math.max(-4, value)) });
  $("exposure").addEventListener("input", (event) => expose(event.target.valueAsNumber));
  $("lift").addEventListener("input", (event) => {
    set({ lamp: [...view.state.lamp.slice(0, 2), event.target.valueAsNumber] });
  });
  $("share").addEventListener("change", (event) => set({ share: event.target.valueAsNumber }));
  $("share").addEventListener("input", (event) => {
    $("share-value").textContent = number(event.target.valueAsNumber, 2);
  });
  const sow = (seed) => {
    if (!$("seed-row").hidden && Number.isSafeInteger(seed)) set({ seed });
  };
  $("seed").addEventListener("change", (event) => sow(event.target.valueAsNumber));
  $("another").addEventListener("click", () => sow(view.state.seed + 1));
  const reset = () => set({ ...view.initial(), seed: view.state.seed, share: view.state.share });
  $("reset").addEventListener("click", reset);
  $("with-photo").addEventListener("click", () => {
    $("beside").hidden = !$("beside").hidden;
    $("with-photo").setAttribute("aria-pressed", String(!$("beside").hidden));
  });
  const save = async () => {
    const { shape, map, seed } = view.state;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await view.picture());
    link.download = `${about.name}_${shape}_${map}_seed${seed}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    $("status").textContent = `saved ${link.download}`;
  };
  $("save").addEventListener("click", save);

  // --- pointer and touch ------------------------------------------------------------------------
  // Units of the picture from its middle, y up.
  const units = (event) => {
    const box = canvas.getBoundingClientRect(), half = Math.max(box.width, box.height) / 2;
    return [
      (event.clientX - box.left - box.width / 2) / half,
      -(event.clientY - box.top - box.height / 2) / half,
    ];
  };
  const aim = (event) => {
    const [x, y] = units(event).map((value) => value * view.spread);
    set({ lamp: [x, y, view.state.lamp[2]] });
  };
  const move = (dx, dy) => {
    const scale = view.scale * view.spread;
    set({ x: view.state.x - dx * scale, y: view.state.y + dy * scale });
  };
  const zoom = (factor, [x, y] = [0, 0]) => {
    const before = view.scale * view.spread;
    set({ span: view.state.span * factor });
    if (view.state.shape !== "plane") return;
    const less = before - view.scale * view.spread; // what is under the pointer stays there
    set({ x: view.state.x + x * less, y: view.state.y - y * less });
  };
  const fingers = new Map();
  const middle = () => {
    const all = [...fingers.values()];
    const mean = [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
    const apart = all.length > 1 ? Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) : 0;
    return { mean, apart };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, units(event));
    if (event.pointerType === "touch" && fingers.size === 1) aim(event);
    else canvas.classList.add("moving");
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) {
      if (event.pointerType !== "touch") aim(event);
      return;
    }
    if (event.pointerType === "touch" && fingers.size === 1) {
      fingers.set(event.pointerId, units(event));
      aim(event);
      return;
    }
    const before = middle();
    fingers.set(event.pointerId, units(event));
    const now = middle();
    move(now.mean[0] - before.mean[0], now.mean[1] - before.mean[1]);
    if (before.apart > 0 && now.apart > 0) zoom(before.apart / now.apart, now.mean);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, (event) => {
      fingers.delete(event.pointerId);
      if (fingers.size === 0) canvas.classList.remove("moving");
    });
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const steps = event.deltaMode === 0 ? event.deltaY / 400 : event.deltaY / 12;
    zoom(2 ** Math.min(1, Math.max(-1, steps)), units(event));
  }, { passive: false });

  // --- keys -------------------------------------------------------------------------------------
  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const KEYS = {
    p: () => set({ shape: "plane" }),
    s: () => set({ shape: "sphere" }),
    c: () => set({ shape: "cylinder" }),
    l: () => set({ light: view.state.light === "point" ? "room" : "point" }),
    f: () => set({ lamp: [0, 0, FLASH] }),
    n: () => sow(view.state.seed + 1),
    d: save,
    "[": () => expose(view.state.exposure - 0.25),
    "]": () => expose(view.state.exposure + 0.25),
    "+": () => zoom(0.8),
    "=": () => zoom(0.8),
    "-": () => zoom(1.25),
    home: reset,
  };
  MAPS.forEach((map, index) => { KEYS[index + 1] = () => set({ map }); });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=number]")) return;
    const way = ARROWS[event.key];
    if (way) {
      if (event.target !== canvas) return; // elsewhere arrows move sliders and choices
      const [x, y, z] = view.state.lamp;
      if (event.shiftKey) set({ lamp: [x + 0.1 * way[0], y + 0.1 * way[1], z] });
      else move(-0.1 * way[0], -0.1 * way[1]);
    } else {
      const act = KEYS[event.key.toLowerCase()];
      if (!act) return;
      act();
    }
    event.preventDefault();
  });

  // For scripts, and for the tests that compare this picture with Python's.
  window.matcap = { view, set, roomRadiance };
  show();
  fit();
})();
