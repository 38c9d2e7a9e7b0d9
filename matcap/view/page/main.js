// The page: its view, its controls and what they do.

import { EnclosedPages, ServedPages } from "./source.js";
import { ROOMS, roomRadiance } from "./rooms.js";
import { FLASH, GONE, LEFTS, View } from "./view.js";
import { $, CHOICES, make, makeControls, offer, saySlider } from "./controls.js";
import { describe, legend, showScale, showState, showWipe, whereabouts } from "./panel.js";
import { listen, listenToWipe } from "./gestures.js";

const TURN = 12; // seconds of a turn of the turntable
const SAID = 9000; // milliseconds that a notice stays
const PULSE = 4000; // milliseconds between looks whether the server is there

(() => {
  const about = JSON.parse($("about").textContent);
  const canvas = $("canvas");
  let view;
  makeControls();
  describe(about);

  // Show a message for a few seconds.
  let noticed = 0;
  const tell = (words) => {
    $("notice").textContent = words;
    clearTimeout(noticed);
    noticed = setTimeout(() => { $("notice").textContent = ""; }, SAID);
  };
  const trouble = (words) => {
    $("trouble").textContent = words;
    $("trouble").hidden = false;
  };
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

  // --- state ------------------------------------------------------------------------------------
  const there = { none: true, photo: about.piece && about.photo, second: about.second };
  for (const name of LEFTS) offer("left", name, there[name]);
  $("left-choice").hidden = !there.photo && !there.second;
  const set = (changes) => {
    view.set(changes);
    showState(view);
  };

  const fit = () => {
    const ratio = Math.min(devicePixelRatio, 2);
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    view.redraw();
  };
  new ResizeObserver(fit).observe(canvas);

  view.changed = () => {
    $("legend").textContent = legend(view);
    $("where").textContent = whereabouts(view);
    showScale(view);
    showWipe(view);
    const left = view.missing().length;
    $("gone").hidden = view.failure !== GONE;
    $("status").textContent = view.failure
      || (left ? `sharpening: ${left} piece${left > 1 ? "s" : ""} to come` : "");
    canvas.setAttribute("aria-label",
      `${about.name} on a ${view.state.shape}: ${legend(view)}${whereabouts(view)}${left ? ", still sharpening" : ""}`);
  };

  // --- controls ---------------------------------------------------------------------------------
  for (const name of Object.keys(CHOICES)) {
    $(`${name}-choice`).addEventListener("change", ({ target }) => {
      if (target.name !== name) return;
      const home = {
        photo: () => ({ shape: "plane", light: "point", lamp: [0, 0, FLASH], ...view.homeward() }),
        second: () => ({ shape: "plane" }),
      }[target.value];
      set({ [name]: target.value, ...home?.() });
    });
  }
  const expose = (value) => set({ exposure: Math.min(4, Math.max(-4, value)) });
  $("exposure").addEventListener("input", (event) => expose(event.target.valueAsNumber));
  $("lift").addEventListener("input", (event) => {
    set({ lamp: [...view.state.lamp.slice(0, 2), event.target.valueAsNumber] });
  });
  $("share").addEventListener("change", (event) => set({ share: event.target.valueAsNumber }));
  $("share").addEventListener("input", ({ target }) => saySlider("share", target.valueAsNumber));
  const download = (blob, name) => {
    const link = make("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    tell(`saved ${name}`);
  };
  const sow = (seed) => {
    if ($("seed-row").hidden) return;
    const sound = Number.isSafeInteger(seed);
    $("seed-trouble").hidden = sound;
    $("seed").setAttribute("aria-invalid", String(!sound));
    if (sound) set({ seed });
    else $("seed-trouble").textContent = "A seed is a whole number of at most 15 digits.";
  };
  $("seed").addEventListener("change", ({ target }) => {
    sow(target.value.trim() === "" ? NaN : Number(target.value));
  });
  $("another").addEventListener("click", () => sow(view.state.seed + 1));
  const reset = () => set({
    ...view.initial(), seed: view.state.seed, share: view.state.share,
  });
  $("reset").addEventListener("click", reset);
  const save = async () => {
    const { shape, map, seed } = view.state;
    download(await view.picture(), `${about.name}_${shape}_${map}_seed${seed}.png`);
  };
  $("save").addEventListener("click", save);
  const enlarge = () => {
    if (document.fullscreenElement) document.exitFullscreen();
    else $("stage").requestFullscreen().catch(() => {});
  };
  $("large").addEventListener("click", enlarge);
  $("again").addEventListener("click", () => view.set({}));
  const help = () => $("keys-dialog").showModal();
  $("help").addEventListener("click", help);

  // The lamp moves around a plane; a sphere or cylinder rotates under it.
  let turning = 0;
  const turn = () => {
    const on = !turning;
    $("turn").setAttribute("aria-pressed", String(on));
    cancelAnimationFrame(turning);
    turning = 0;
    if (!on) return;
    let before = performance.now();
    const step = (now) => {
      const angle = (2 * Math.PI * (now - before)) / (1000 * TURN);
      before = now;
      const { shape, lamp: [x, y, z], x: column } = view.state;
      const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
      if (shape === "plane") view.set({ lamp: [x * cos - y * sin, x * sin + y * cos, z] });
      else view.set({ x: column + angle * view.scale });
      turning = requestAnimationFrame(step);
    };
    turning = requestAnimationFrame(step);
  };
  $("turn").addEventListener("click", turn);

  // --- behaviour --------------------------------------------------------------------------------
  $("hint").textContent = matchMedia("(pointer: coarse)").matches
    ? "Touch to light it, two fingers to wander" : "Move to light it, drag to wander, scroll to zoom";
  const moved = () => $("hint").classList.add("gone");
  listen(view, set, {
    expose,
    keys: { n: () => sow(view.state.seed + 1), d: save, t: turn, b: enlarge, home: reset, "?": help },
  }, moved);
  listenToWipe(view, $("wipe"), set);
  canvas.addEventListener("wheel", moved, { passive: true });
  if (!about.tile) {
    setInterval(() => {
      if (document.hidden || view.loading.size) return;
      fetch("alive").then(() => { if (view.failure === GONE) view.set({}); }, () => {
        view.failure = GONE;
        view.changed();
      });
    }, PULSE);
  }

  // For scripts, and for the tests that compare this picture with Python's.
  window.matcap = { view, set, room: (name, d) => roomRadiance(ROOMS[name], d) };
  set({});
  fit();
})();
