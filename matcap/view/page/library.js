// The library: each material on a sphere, under one light that follows the pointer.

import { $, make } from "./controls.js";
import { dressed, followTheme } from "./theme.js";
import { parseAdjustments, useAdjustments } from "./adjust.js";
import { Pages } from "./pages.js";
import { UNIT, buildProgram } from "./shader.js";
import { pageOf } from "./source.js";

const SPAN = 460; // texels of a sphere's diameter
const AROUND = 1.12; // half a card's width, in radii
const LIFT = 1.5; // of the light, in radii above the nearest point
const NEARER = 0.4; // sideways it is nearer than the pointer, or far spheres would be dark
const MOST = 48; // swatches held
const CAMERA = 1.25 / AROUND; // the shader's own room around a sphere

const about = JSON.parse($("about").textContent);
const canvas = $("canvas");

class Shelf {
  constructor(gl) {
    const form = about.page;
    this.gl = gl;
    this.pages = new Pages(gl, form, MOST);
    const places = buildProgram(gl, form);
    this.places = places;
    useAdjustments(gl, places, parseAdjustments(about.adjust));
    gl.uniform4f(places.middle, form.width / 2, form.height / 2, 0, 0);
    gl.uniform1f(places.tableScale, 2 ** -about.level);
    gl.uniform1f(places.texels, SPAN / 2);
    gl.uniform4f(places.bounds, -3e38, -3e38, 3e38, 3e38);
    gl.uniform1i(places.shape, 1);
    gl.uniform1i(places.map, 0);
    gl.uniform3f(places.lens, 0, 0, -1);
    gl.uniform3f(places.cone, 0, 0, -1);
    gl.uniform2f(places.lost, 0, 0);
    gl.uniform1i(places.room, 0);
    gl.uniform1f(places.gain, 1);
    gl.uniform3f(places.meanDiffuse, 0.2, 0.2, 0.2);
    gl.uniform3f(places.meanF0, 0.04, 0.04, 0.04);
    gl.uniform4f(places.meanSurface, 0.06, 0, 0, 0);
    this.light = [innerWidth * 0.35, innerHeight * 0.3];
  }

  // Draw every visible sphere at the position of its card.
  draw(cards) {
    const { gl, places } = this, ratio = canvas.width / innerWidth;
    const ground = dressed();
    this.pages.bind(UNIT);
    gl.uniform3f(places.ground, ...ground);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    for (const card of cards) {
      const box = card.face.getBoundingClientRect();
      if (card.box.hidden || box.bottom < 0 || box.top > innerHeight) continue;
      if (!this.pages.has(about.level, card.index, 0)) continue;
      const side = box.width * ratio, x = box.left * ratio, y = canvas.height - box.bottom * ratio;
      gl.viewport(x, y, side, side);
      gl.scissor(x, y, side, side);
      gl.uniform2f(places.size, side, side);
      gl.uniform2f(places.corner, x, y);
      const radius = box.width / 2 / (AROUND * CAMERA);
      const [dx, dy] = [this.light[0] - box.left - box.width / 2, box.top + box.width / 2 - this.light[1]];
      const place = [(NEARER * dx) / radius, (NEARER * dy) / radius, LIFT + 1];
      const away = Math.max(Math.hypot(...place) - 1, 0.05);
      gl.uniform3f(places.lightPlace, ...place);
      gl.uniform3fv(places.intensity, Array(3).fill(Math.PI * away * away));
      this.pages.show(about.level, card.index, 0);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }
}

// Two materials to compare: the first waits for the second.
const comparing = { first: null };

function choose(card) {
  const { first } = comparing, name = card?.material.name;
  first?.button.setAttribute("aria-pressed", "false");
  comparing.first = null;
  if (!card || card === first) {
    $("chosen").textContent = first ? `${first.material.name} is let go.` : "";
  } else if (first) {
    $("chosen").textContent = `Comparing ${first.material.name} with ${name}.`;
    compare(first.index, card.index);
  } else {
    comparing.first = card;
    card.button.setAttribute("aria-pressed", "true");
    $("chosen").textContent = `${name} is chosen. Choose another one to compare it with.`;
  }
}

function compare(first, second) {
  location.href = `m/${first}+${second}/#left=second`;
}

function makeCard(material, index) {
  const face = make("span", { className: "face" });
  const name = make("span", { className: "called", textContent: material.name });
  const link = make("a", { href: `m/${index}/`, draggable: true }, face, name);
  const button = make("button", { type: "button", className: "quiet", textContent: "Compare" });
  button.setAttribute("aria-pressed", "false");
  button.setAttribute("aria-label", `Compare ${material.name} with another`);
  const box = make("div", { className: "card" }, link, button);
  const card = { box, link, face, button, index, material };
  button.addEventListener("click", () => choose(card));
  box.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "c" || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    choose(card);
  });
  if (material.rating) {
    const { rating, sentence } = material;
    link.append(make("span", { className: `rating ${rating}`, textContent: rating, title: sentence }));
  }
  link.addEventListener("dragstart", (event) => event.dataTransfer.setData("text/plain", String(index)));
  box.addEventListener("dragover", (event) => {
    event.preventDefault();
    box.classList.add("over");
  });
  box.addEventListener("dragleave", () => box.classList.remove("over"));
  box.addEventListener("drop", (event) => {
    event.preventDefault();
    box.classList.remove("over");
    const other = Number(event.dataTransfer.getData("text/plain"));
    if (Number.isInteger(other) && other !== index) compare(index, other);
  });
  $("shelf").append(box);
  return card;
}

(() => {
  $("name").textContent = about.name;
  const cards = about.shelf.map(makeCard);
  for (const rating of new Set(about.shelf.map((one) => one.rating).filter(Boolean))) {
    $("rating").append(new Option(rating));
  }
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false });
  if (!gl) {
    $("trouble").textContent = "This browser gives no WebGL2, which the spheres are drawn with.";
    $("trouble").hidden = false;
  }
  const shelf = gl && new Shelf(gl);
  let pending = 0;
  const redraw = () => {
    if (!pending && shelf) pending = requestAnimationFrame(() => { pending = 0; shelf.draw(cards); });
  };
  const fit = () => {
    const ratio = Math.min(devicePixelRatio, 2);
    canvas.width = Math.round(innerWidth * ratio);
    canvas.height = Math.round(innerHeight * ratio);
    redraw();
  };
  const filter = () => {
    const text = $("find").value.toLowerCase(), rating = $("rating").value;
    for (const { box, material } of cards) {
      box.hidden = !material.name.toLowerCase().includes(text)
        || (rating !== "" && material.rating !== rating);
    }
    const shown = cards.filter(({ box }) => !box.hidden).length;
    $("status").textContent = `${shown} of ${cards.length} materials`;
    redraw();
  };
  $("find").addEventListener("input", filter);
  $("rating").addEventListener("change", filter);
  followTheme(redraw);
  addEventListener("keydown", ({ key }) => { if (key === "Escape") choose(null); });
  addEventListener("pageshow", () => { if (comparing.first) choose(null); }); // come back to
  addEventListener("resize", fit);
  addEventListener("scroll", redraw, { passive: true });
  addEventListener("pointermove", (event) => {
    if (shelf) shelf.light = [event.clientX, event.clientY];
    redraw();
  });
  fit();
  filter();

  // Load swatches one after the other, as cards become visible.
  const waiting = [];
  let fetching = false;
  const next = async () => {
    if (fetching || waiting.length === 0) return;
    fetching = true;
    const card = waiting.shift();
    try {
      const answer = await fetch(`swatch?index=${card.index}`);
      if (!answer.ok) throw new Error((await answer.text()).slice(0, 200));
      shelf.pages.put(about.level, card.index, 0, await pageOf(answer, about.page), 0);
      redraw();
    } catch (error) {
      card.link.title = error instanceof TypeError ? "matcap view has ended" : error.message;
      card.box.classList.add("broken");
      card.button.hidden = true;
    }
    fetching = false;
    next();
  };
  const watcher = new IntersectionObserver((seen) => {
    for (const { isIntersecting, target } of seen) {
      const card = cards.find(({ box }) => box === target);
      if (!isIntersecting || !shelf || shelf.pages.has(about.level, card.index, 0)) continue;
      if (!waiting.includes(card)) waiting.push(card);
    }
    shelf?.pages.use(cards.map(({ index }) => ({ level: about.level, column: index, row: 0 })));
    next();
  }, { rootMargin: "200px" });
  for (const { box } of cards) watcher.observe(box);
  window.matcap = { shelf, cards };
})();
