// Pointer, touch and keyboard input to changes of the state.

import { FLASH, LIGHTS, MAPS } from "./view.js";

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

// `set` changes the state; `acts` are further actions of keys; `moved` is called at every drag.
export function listen(view, set, acts, moved) {
  const { canvas } = view;
  // Position in units of the picture from its middle, y up.
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
  let touched = false; // by one finger, which has not moved yet
  const middle = () => {
    const all = [...fingers.values()];
    const mean = [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
    const apart = all.length > 1 ? Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) : 0;
    return { mean, apart };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, units(event));
    // A second finger may follow, and the light must not have moved then.
    touched = event.pointerType === "touch" && fingers.size === 1;
    if (!touched) canvas.classList.add("moving");
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) {
      if (event.pointerType !== "touch") aim(event);
      return;
    }
    moved();
    touched = false;
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
      if (touched && kind === "pointerup") aim(event);
      touched = false;
      if (fingers.size === 0) canvas.classList.remove("moving");
    });
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const steps = event.deltaMode === 0 ? event.deltaY / 400 : event.deltaY / 12;
    zoom(2 ** Math.min(1, Math.max(-1, steps)), units(event));
  }, { passive: false });

  const keys = {
    p: () => set({ shape: "plane" }),
    s: () => set({ shape: "sphere" }),
    c: () => set({ shape: "cylinder" }),
    l: () => set({ light: LIGHTS[(LIGHTS.indexOf(view.state.light) + 1) % LIGHTS.length] }),
    f: () => set({ lamp: [0, 0, FLASH], light: "point" }),
    "[": () => acts.expose(view.state.exposure - 0.25),
    "]": () => acts.expose(view.state.exposure + 0.25),
    "+": () => zoom(0.8),
    "=": () => zoom(0.8),
    "-": () => zoom(1.25),
    ...acts.keys,
  };
  MAPS.forEach((map, index) => { keys[index + 1] = () => set({ map }); });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=text], input[type=search], select, dialog *")) return;
    const way = ARROWS[event.key];
    if (way) {
      if (event.target !== canvas) return; // elsewhere arrows move sliders and choices
      const [x, y, z] = view.state.lamp;
      if (event.shiftKey) set({ lamp: [x + 0.1 * way[0], y + 0.1 * way[1], z] });
      else move(-0.1 * way[0], -0.1 * way[1]);
    } else {
      if (!keys[event.key.toLowerCase()]) return;
      keys[event.key.toLowerCase()]();
    }
    event.preventDefault();
  });
}

// Move the wipe, by dragging or by arrow keys.
export function listenToWipe(view, wipe, set) {
  const place = (share) => set({ wipe: Math.min(Math.max(share, 0), 1) });
  wipe.addEventListener("pointerdown", (event) => {
    wipe.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  wipe.addEventListener("pointermove", (event) => {
    if (!wipe.hasPointerCapture(event.pointerId)) return;
    const box = view.canvas.getBoundingClientRect();
    place((event.clientX - box.left) / box.width);
  });
  wipe.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.05, ArrowRight: 0.05, Home: -1, End: 1 }[event.key];
    if (step === undefined) return;
    place(view.state.wipe + step);
    event.preventDefault();
    event.stopPropagation();
  });
}
