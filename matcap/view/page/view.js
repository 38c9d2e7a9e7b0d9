// The renderer: state in, picture out. Independent of controls.

import { CELLS, LEAST_RANGE, Pages } from "./pages.js";
import { UNIT, buildProgram } from "./shader.js";
import { ROOMS, roomPicture } from "./rooms.js";
import { Surroundings } from "./surroundings.js";

export const SHAPES = ["plane", "sphere", "cylinder"];
export const LIGHTS = ["point", ...Object.keys(ROOMS)];
// What may be to the left of the wipe: nothing, the photograph, or the second material's field.
export const LEFTS = ["none", "photo", "second"];
export const MAPS = ["lit", "diffuse", "specular", "roughness", "height", "normal"];
// Framing as in the shader: a sphere as in matcap relight, a cylinder with its full height.
const ROOM_AROUND = { sphere: 1.25, cylinder: 1.6 };
export const FLASH = 1 / Math.tan(Math.PI / 8);
const NEAREST = 4, FARTHEST = 2 ** 30; // texels across
const FARTHEST_LEVEL = 21;
const COARSER = 3; // levels between what is sharp and what comes first
const MIRRORED = 48, HURRIED = 8; // directions of a room, and while anything moves
const STRIPS = 12; // that a picture is settled in
const SETTLED = 200; // milliseconds after which nothing moves any more
const SPARE = 12; // pages kept for coarse forms and for what was just seen
export const GONE = "The server does not answer.";

export class View {
  // Throws without WebGL2.
  constructor(canvas, about, source) {
    const gl = canvas.getContext("webgl2", {
      alpha: false, antialias: false, preserveDrawingBuffer: true, // to be settled in strips
    });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, source, about });
    // Small devices cache fewer pages: 130 MB of textures, not 320.
    const small = Math.min(screen.width, screen.height) < 700, count = small ? 26 : 64;
    this.pages = new Pages(gl, source.form, count);
    this.field = { name: "field", pages: this.pages, count };
    // The second material alone, in no more memory than a small device has.
    this.second = { name: "second", pages: null, count: 26 };
    this.rooms = new Map(); // surroundings by the light's name, made when they are first seen
    const places = buildProgram(gl, source.form);
    this.places = places;
    // F0 has one channel or three, as in level_of_detail.py.
    const albedo = about.mean.slice(0, -5), [alpha2, , , squares] = about.mean.slice(-5);
    const f0 = albedo.length > 4 ? albedo.slice(3) : Array(3).fill(albedo[3]);
    gl.uniform3f(places.meanDiffuse, ...albedo.slice(0, 3));
    gl.uniform3f(places.meanF0, ...f0);
    gl.uniform4f(places.meanSurface, alpha2, 0, 0, squares);
    this.state = this.initial();
    this.loading = new Map();
    this.failure = "";
    this.changed = () => {};
  }

  initial() {
    const { width, height } = this.source.form;
    return {
      shape: "plane", map: "lit", light: "point", exposure: 0, seed: this.about.seed, share: 0,
      x: 4 * width, y: 4 * height, // texel in the middle; y downwards
      span: 1.5 * width, // texels across the long side, or a sphere's diameter
      left: "none", wipe: 0.5, // what is to the left of the wipe, and where that is
      lamp: [-0.35, 0.3, 1], // in units of half the long side, or of the radius
    };
  }

  set(changes) {
    const before = this.state;
    this.state = { ...before, ...changes };
    this.state.span = Math.min(Math.max(this.state.span, NEAREST), FARTHEST);
    const sown = before.seed !== this.state.seed;
    if (sown || before.share !== this.state.share) this.#forget(this.field);
    if (sown) this.#forget(this.second);
    this.failure = "";
    this.redraw();
  }

  // Drop a layer's pages, and those that are being loaded.
  #forget(layer) {
    for (const [key, { stop }] of this.loading) {
      if (!key.startsWith(layer.name)) continue;
      stop.abort();
      this.loading.delete(key);
    }
    layer.pages?.clear();
  }

  // Texels per unit.
  get scale() {
    return this.state.span / 2;
  }

  // Half the visible extent, in texels.
  #reach() {
    const { width, height } = this.canvas, long = Math.max(width, height);
    if (this.state.shape === "plane") return [width / long, height / long].map((v) => v * this.scale);
    const upwards = this.state.shape === "sphere" ? Math.PI / 2 : 1;
    return [(this.scale * Math.PI) / 2, this.scale * upwards];
  }

  // Level whose texels are about as large as pixels.
  get level() {
    const { width, height } = this.canvas, half = Math.max(width, height) / 2;
    let footprint = 1 / half;
    if (this.state.shape !== "plane") {
      const reach = 1 / FLASH;
      footprint *= this.spread - reach;
    }
    const exact = Math.floor(Math.log2(Math.max(footprint * this.scale, 1)) + 1e-9);
    return Math.min(exact, FARTHEST_LEVEL);
  }

  get wiped() {
    return this.state.left !== "none" && this.state.shape === "plane";
  }

  // What to draw, the left side of the wipe last.
  get #sides() {
    return this.wiped ? ["field", this.state.left] : ["field"];
  }

  #layerOf(side) {
    return side === "second" ? this.second : this.field;
  }

  // Layers that are drawn from pages.
  get layers() {
    return this.#sides.filter((side) => side !== "photo").map((side) => this.#layerOf(side));
  }

  // Borders of the photograph, in texels from the picture's middle: left, top, right, below. The
  // photograph's middle is where the view begins.
  #photographed() {
    const { x, y } = this.state, home = this.initial(), [wide, tall] = this.about.piece;
    const [left, top] = [home.x - wide / 2 - x, home.y - tall / 2 - y];
    return [left, top, left + wide, top + tall];
  }

  // First and last column and row of visible pages of a level.
  seen(level) {
    const { width, height } = this.source.form, [across, down] = this.#reach();
    const { x, y } = this.state;
    const range = (middle, reach, side) => {
      const first = Math.floor((middle - reach) / side);
      return [first, Math.max(Math.ceil((middle + reach) / side) - 1, first)];
    };
    return { columns: range(x, across, width * 2 ** level), rows: range(y, down, height * 2 ** level) };
  }

  #listed(level, layer) {
    const { width, height } = this.source.form, { columns, rows } = this.seen(level);
    const found = [];
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        const x = (column + 0.5) * width * 2 ** level - this.state.x;
        const y = (row + 0.5) * height * 2 ** level - this.state.y;
        found.push({ layer, level, column, row, far: x * x + y * y });
      }
    }
    return found.sort((a, b) => a.far - b.far);
  }

  // Visible pages in order of priority: a coarse level of everything, then the sharp level, nearest
  // to the middle first. `best` is the sharp level, coarser than needed if the cache is too small
  // for all pages.
  wanted(layer = this.field) {
    let best = this.level;
    while (this.#count(best) > layer.count - SPARE && best < FARTHEST_LEVEL) best += 1;
    const coarse = this.#listed(Math.min(best + COARSER, FARTHEST_LEVEL), layer);
    return { best, pages: [...coarse, ...this.#listed(best, layer)] };
  }

  #count(level) {
    const { columns, rows } = this.seen(level);
    return (columns[1] - columns[0] + 1) * (rows[1] - rows[0] + 1);
  }

  redraw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.#fetch();
      const hurried = this.state.light !== "point" && this.state.map === "lit";
      this.draw(hurried ? HURRIED : MIRRORED);
      this.changed();
      clearTimeout(this.settling);
      if (hurried && this.loading.size === 0) {
        this.settling = setTimeout(() => this.#settle(0), SETTLED);
      }
    });
  }

  // While nothing moves, draw with all samples of the environment, in strips to stay responsive.
  #settle(index) {
    const tall = Math.ceil(this.canvas.height / STRIPS);
    this.strip = { bottom: this.canvas.height - (index + 1) * tall, tall };
    this.draw();
    this.strip = null;
    if (index + 1 < STRIPS) this.settling = setTimeout(() => this.#settle(index + 1), 0);
  }

  // Draw now.
  draw(mirrored = MIRRORED) {
    const { gl, places, state, canvas } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.uniform2f(places.size, canvas.width, canvas.height);
    gl.uniform3f(places.ground, ...groundColour());
    gl.uniform1f(places.texels, this.scale);
    gl.uniform1i(places.shape, SHAPES.indexOf(state.shape));
    gl.uniform1i(places.map, MAPS.indexOf(state.map));
    gl.uniform1i(places.mirrored, mirrored);
    gl.uniform1f(places.gain, 2 ** state.exposure);
    gl.uniform2f(places.range, ...this.range());
    gl.uniformMatrix3fv(places.turned, false, this.#turned());
    const { place, intensity } = this.lamp();
    gl.uniform3f(places.lightPlace, ...place);
    gl.uniform1f(places.intensity, intensity);
    gl.uniform1i(places.room, state.light === "point" ? 0 : 1);
    if (state.light !== "point") this.#room();
    this.#sides.forEach((side, index) => this.#drawSide(side, index ? state.wipe : 1));
  }

  #room() {
    const { gl, state, rooms } = this;
    if (!rooms.has(state.light)) {
      rooms.set(state.light, new Surroundings(gl, roomPicture(ROOMS[state.light])));
    }
    rooms.get(state.light).use(gl, UNIT);
  }

  // Load the photograph.
  #photograph() {
    if (this.photo) return this.photo.there;
    const { gl } = this, picture = new Image();
    this.photo = { there: false };
    picture.src = this.about.photo;
    picture.decode().then(() => {
      gl.activeTexture(gl.TEXTURE0 + UNIT.photograph);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.activeTexture(gl.TEXTURE0 + UNIT.spare);
      this.photo.there = true;
      this.redraw();
    }, () => {
      this.failure = "The photograph cannot be read.";
      this.changed();
    });
    return false;
  }

  #drawSide(side, across) {
    const { gl, canvas, places } = this, isPhoto = side === "photo";
    gl.uniform1i(places.photographed, isPhoto ? 1 : 0);
    gl.uniform4f(places.bounds, ...(isPhoto ? this.#photographed() : [-3e38, -3e38, 3e38, 3e38]));
    if (isPhoto && !this.#photograph()) return; // it will be drawn when it is there
    if (!isPhoto) this.#drawPages(this.#layerOf(side));
    const { bottom, tall } = this.strip || { bottom: 0, tall: canvas.height };
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, bottom, Math.round(across * canvas.width), tall);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Pages of a second material are created at the first use.
  #open(layer) {
    layer.pages ||= new Pages(this.gl, this.source.form, layer.count);
    return layer.pages;
  }

  // Bind textures of a layer for drawing.
  #drawPages(layer) {
    this.#open(layer);
    const { best, pages } = this.wanted(layer);
    layer.pages.use(pages);
    const cells = Math.max(best - 1, 0), { columns, rows } = this.seen(cells);
    layer.pages.update(cells, best, columns, rows);
    layer.pages.bind(UNIT);
    this.#placed(cells);
  }

  // Set the uniforms of the position in a table of cells.
  #placed(cells) {
    const { gl, places } = this, { width, height } = this.source.form;
    const [x, y] = [this.state.x / (width * 2 ** cells), this.state.y / (height * 2 ** cells)];
    const turn = (value) => Math.floor(value) - Math.floor(value / CELLS) * CELLS;
    const within = (value, side) => (value - Math.floor(value)) * side;
    gl.uniform4f(places.middle, within(x, width), within(y, height), turn(x), turn(y));
    gl.uniform1f(places.tableScale, 2 ** -cells);
  }

  // Fit the photograph to the picture.
  homeward() {
    const { clientWidth, clientHeight } = this.canvas, [wide, tall] = this.about.piece;
    const { x, y } = this.initial();
    const long = Math.max(clientWidth, clientHeight);
    return { x, y, span: long * Math.max(wide / clientWidth, tall / clientHeight) };
  }

  // Values that black and white stand for in the displayed map.
  range() {
    const { map } = this.state;
    return map in LEAST_RANGE ? this.pages.range(map) : [0, 1];
  }

  // Half the visible extent at the surface's middle, in units.
  get spread() {
    if (this.state.shape === "plane") return 1;
    const { width, height } = this.canvas;
    return (ROOM_AROUND[this.state.shape] * Math.max(width, height)) / Math.min(width, height);
  }

  // Position of the lamp and its radiant intensity: white is displayed as white where it is
  // nearest.
  lamp() {
    const [x, y, z] = this.state.lamp;
    if (this.state.shape === "plane") return { place: [x, y, z], intensity: Math.PI * z * z };
    const place = [x, y, z + 1]; // counted from the nearest point of the surface
    const away = Math.max(Math.hypot(...place) - 1, 0.05);
    return { place, intensity: Math.PI * away * away };
  }

  // Matrix from scene to room, by columns; the pointer rotates the room about y and then x.
  #turned() {
    const [x, y] = this.state.lamp;
    const [sx, cx] = [Math.sin(x + 0.35), Math.cos(x + 0.35)];
    const [sy, cy] = [Math.sin(y - 0.3), Math.cos(y - 0.3)];
    return [cx, sy * sx, cy * sx, 0, cy, -sy, -sx, sy * cx, cy * cx];
  }

  // Visible pages that are not loaded, in order of priority.
  missing() {
    return this.layers.flatMap((layer) => this.wanted(layer).pages).filter(
      ({ layer, level, column, row }) => !layer.pages || !layer.pages.has(level, column, row),
    );
  }

  #fetch() {
    const missing = this.missing();
    const keyOf = ({ layer, level, column, row }) => `${layer.name} ${Pages.key(level, column, row)}`;
    const keys = new Set(missing.map(keyOf));
    for (const [key, { stop }] of this.loading) {
      if (keys.has(key)) continue;
      stop.abort(); // it has left the view
      this.loading.delete(key);
    }
    if (this.failure) return;
    for (const place of missing) {
      if (this.loading.size >= this.source.most) return;
      const key = keyOf(place);
      if (this.loading.has(key)) continue;
      const stop = new AbortController(), entry = { stop };
      this.loading.set(key, entry);
      const { seed } = this.state, share = place.layer === this.second ? 1 : this.state.share;
      this.source.load(place, { seed, share }, stop.signal).then(
        (page) => {
          if (this.loading.get(key) !== entry) return; // nobody waits for it any more
          this.loading.delete(key);
          if (place.layer === this.field) this.texelSize = page.texelSize;
          this.#open(place.layer).put(place.level, place.column, place.row, page);
          this.#fetch(); // at once: a frame may take longer than a page
          this.redraw();
        },
        (error) => {
          if (this.loading.get(key) !== entry) return;
          this.loading.delete(key);
          this.failure = error instanceof TypeError ? GONE : error.message;
          this.redraw();
        },
      );
    }
  }

  // Whether all visible pages are loaded.
  get complete() {
    const unseen = this.#sides.includes("photo") && !this.photo?.there;
    return this.missing().length === 0 && !unseen;
  }

  // The picture as a PNG.
  picture() {
    clearTimeout(this.settling);
    this.draw();
    return new Promise((done) => { this.canvas.toBlob(done, "image/png"); });
  }
}

// Background colour, components from 0 to 1.
function groundColour() {
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255);
}
