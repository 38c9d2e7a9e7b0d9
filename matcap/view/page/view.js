// The renderer: state in, picture out. Independent of controls.

import { parseAdjustments, useAdjustments } from "./adjust.js";
import { CELLS, LEAST_RANGE, Pages } from "./pages.js";
import { UNIT, buildProgram } from "./shader.js";
import { ROOMS, roomPicture } from "./rooms.js";
import { Surroundings } from "./surroundings.js";
import { dressed } from "./theme.js";

export const SHAPES = ["plane", "sphere", "cylinder"];
const LIGHTS = ["point", ...Object.keys(ROOMS), "own"];
// What either side of the wipe may show: the photograph, the exemplar under the photograph's flash,
// the exemplar under the page's light, the second material's endless field, the field or blend.
export const LEFTS = ["none", "photo", "flash", "piece", "second"];
export const RIGHTS = ["flash", "piece", "field"];
export const MAPS = ["lit", "diffuse", "specular", "roughness", "height", "normal"];
// Framing as in the shader: a sphere as in matcap relight, a cylinder with its full height.
const ROOM_AROUND = { sphere: 1.25, cylinder: 1.6 };
export const FLASH = 1 / Math.tan(Math.PI / 8);
const CAMERA = { place: [0, 0, FLASH], lens: [0, 0, -1], cone: [0, 0, -1], lost: [0, 0] };
const ORDINARY = 0.35; // mean radiance of surroundings that need no other exposure
const NEAREST = 4, FARTHEST = 2 ** 30; // texels across
const FARTHEST_LEVEL = 21;
const COARSER = 3; // levels between what is sharp and what comes first
const MIRRORED = 48, HURRIED = 8; // directions of a room, and while anything moves
const STRIPS = 12; // that a picture is settled in
const SETTLED = 200; // milliseconds after which nothing moves any more
const PIECES = 20; // pages of the piece
const SPARE = 12, SPARE_PIECE = 4; // pages kept for coarse forms and for what was just seen
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
    this.field = { name: "field", pages: this.pages, finest: 0, count, spare: SPARE };
    // The second material alone, in no more memory than a small device has.
    this.second = { name: "second", pages: null, finest: 0, count: 26, spare: SPARE };
    // The exemplar, if there is one; its finest level may be coarser than the field's.
    this.piece = about.piece && { name: "piece", pages: null, finest: about.piece_level,
      count: PIECES, spare: SPARE_PIECE };
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
    this.fades = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.drawn = 0;
  }

  initial() {
    const { width, height } = this.source.form;
    return {
      shape: "plane", map: "lit", light: "point", exposure: 0, seed: this.about.seed, share: 0,
      x: 4 * width, y: 4 * height, // texel in the middle; y downwards
      span: 1.5 * width, // texels across the long side, or a sphere's diameter
      left: "none", right: "field", wipe: 0.5, // what is on either side of the wipe, and where that is
      adjust: parseAdjustments(this.about.adjust),
      // In units of half the long side, or of the radius; of a photograph, its flash.
      lamp: this.about.flash?.light ?? [-0.35, 0.3, 1],
    };
  }

  set(changes) {
    const before = this.state;
    this.state = { ...before, ...changes };
    if (!this.lights.includes(this.state.light)) this.state.light = "point";
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

  // Lights to choose from.
  get lights() {
    return LIGHTS.filter((name) => name !== "own" || this.own);
  }

  // Set an environment map of the user's (surroundings.js).
  surround(picture) {
    this.rooms.get("own")?.dispose(this.gl);
    this.own = new Surroundings(this.gl, picture);
    this.rooms.set("own", this.own);
    const stops = Math.log2(ORDINARY / Math.max(this.own.mean, 1e-6));
    this.set({ light: "own", exposure: Math.min(4, Math.max(-4, Math.round(stops * 4) / 4)) });
  }

  get wiped() {
    return this.state.left !== "none" && this.state.shape === "plane";
  }

  // Layers to draw, the left side of the wipe last.
  get #sides() {
    return this.wiped ? [this.state.right, this.state.left] : ["field"];
  }

  #layerOf(side) {
    return { field: this.field, second: this.second }[side] || this.piece;
  }

  // Layers that are drawn from pages.
  get layers() {
    const sides = this.#sides.filter((side) => side !== "photo");
    return [...new Set(sides.map((side) => this.#layerOf(side)))];
  }

  // The texel of a layer in the picture's middle, and half its visible extent. The exemplar's
  // middle is where the view begins.
  #whereabouts(layer) {
    const { x, y } = this.state;
    if (layer !== this.piece) return { x, y, bounds: [-Infinity, -Infinity, Infinity, Infinity] };
    const home = this.initial(), [wide, tall] = this.about.piece;
    return { x: x - home.x + wide / 2, y: y - home.y + tall / 2, bounds: [0, 0, wide, tall] };
  }

  // First and last column and row of visible pages of a level.
  seen(level, layer = this.field) {
    const { width, height } = this.source.form, [across, down] = this.#reach();
    const { x, y, bounds } = this.#whereabouts(layer);
    const range = (from, to, side) => {
      const first = Math.floor(from / side);
      return [first, Math.max(Math.ceil(to / side) - 1, first)];
    };
    const [wide, tall] = [width * 2 ** level, height * 2 ** level];
    return {
      columns: range(Math.max(x - across, bounds[0]), Math.min(x + across, bounds[2]), wide),
      rows: range(Math.max(y - down, bounds[1]), Math.min(y + down, bounds[3]), tall),
    };
  }

  #listed(level, layer) {
    const { width, height } = this.source.form, { columns, rows } = this.seen(level, layer);
    const where = this.#whereabouts(layer);
    const found = [];
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        const x = (column + 0.5) * width * 2 ** level - where.x;
        const y = (row + 0.5) * height * 2 ** level - where.y;
        found.push({ layer, level, column, row, far: x * x + y * y });
      }
    }
    return found.sort((a, b) => a.far - b.far);
  }

  // Visible pages in order of priority: a coarse level of everything, then the sharp level, nearest
  // to the middle first. `best` is the sharp level, coarser than needed if the cache is too small
  // for all pages.
  wanted(layer = this.field) {
    let best = Math.max(this.level, layer.finest);
    const room = layer.count - layer.spare;
    while (this.#count(best, layer) > room && best < FARTHEST_LEVEL) best += 1;
    const coarse = this.#listed(Math.min(best + COARSER, FARTHEST_LEVEL), layer);
    return { best, pages: [...coarse, ...this.#listed(best, layer)] };
  }

  #count(level, layer) {
    const { columns, rows } = this.seen(level, layer);
    return (columns[1] - columns[0] + 1) * (rows[1] - rows[0] + 1);
  }

  redraw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame((now) => {
      this.pending = 0;
      this.#fetch();
      const hurried = this.state.light !== "point" && this.state.map === "lit";
      const appearing = this.draw(now, hurried ? HURRIED : MIRRORED);
      if (appearing) this.redraw();
      this.changed();
      clearTimeout(this.settling);
      if (hurried && !appearing && this.loading.size === 0) {
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

  // Draw now; returns whether a page is still fading in.
  draw(now = Infinity, mirrored = MIRRORED) {
    const { gl, places, state, canvas } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.uniform2f(places.size, canvas.width, canvas.height);
    gl.uniform3f(places.ground, ...dressed());
    gl.uniform1f(places.texels, this.scale);
    gl.uniform1i(places.shape, SHAPES.indexOf(state.shape));
    gl.uniform1i(places.map, MAPS.indexOf(state.map));
    gl.uniform1i(places.mirrored, mirrored);
    gl.uniform1f(places.gain, 2 ** state.exposure);
    gl.uniform2f(places.range, ...this.range());
    useAdjustments(gl, places, state.adjust);
    gl.uniformMatrix3fv(places.turned, false, this.#turned());
    if (state.light !== "point") this.#room();
    let appearing = false, across = 1;
    for (const side of this.#sides) {
      appearing = this.#drawSide(side, across, now) || appearing;
      across = state.wipe;
    }
    this.drawn += 1;
    return appearing;
  }

  #room() {
    const { gl, state, rooms } = this;
    if (!rooms.has(state.light)) {
      rooms.set(state.light, new Surroundings(gl, roomPicture(ROOMS[state.light])));
    }
    rooms.get(state.light).use(gl, this.places, UNIT);
  }

  // Camera and light of a side.
  #light(side) {
    const { gl, places, state, about } = this;
    gl.uniform1i(places.room, side !== "flash" && state.light !== "point" ? 1 : 0);
    gl.uniform1i(places.photographed, side === "photo" ? 1 : 0);
    let { place: from, lens, cone, lost } = CAMERA, { place, intensity } = this.lamp();
    intensity = [intensity, intensity, intensity];
    if (side === "flash") {
      // The photograph's long side is two plane units, its middle the origin.
      const { camera, light, axis, intensity: power, vignetting } = about.flash;
      const where = this.#whereabouts(this.piece), [wide, tall] = about.piece;
      const plane = 2 / wide, unit = this.scale * plane;
      const middle = [(where.x - wide / 2) * plane, (tall / 2 - where.y) * plane, 0];
      const seen = (point) => point.map((value, k) => (value - middle[k]) / unit);
      [from, place, lens, lost] = [seen(camera), seen(light), axis, vignetting];
      cone = about.flash.cone;
      intensity = power.map((value) => value / unit ** 2);
    }
    gl.uniform3f(places.viewPlace, ...from);
    gl.uniform3f(places.lens, ...lens);
    gl.uniform3f(places.cone, ...cone);
    gl.uniform2f(places.lost, ...lost);
    gl.uniform3f(places.lightPlace, ...place);
    gl.uniform3f(places.intensity, ...intensity);
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

  #drawSide(side, across, now) {
    const { gl, canvas } = this, layer = this.#layerOf(side);
    this.#light(side);
    let appearing = false;
    if (side === "photo") {
      this.#placed(layer, 0);
      if (!this.#photograph()) return false; // it will be drawn when it is there
    } else {
      appearing = this.#drawPages(layer, now);
    }
    const { bottom, tall } = this.strip || { bottom: 0, tall: canvas.height };
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, bottom, Math.round(across * canvas.width), tall);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return appearing;
  }

  // Pages of the exemplar and of a second material are created at the first use.
  #open(layer) {
    layer.pages ||= new Pages(this.gl, this.source.form, layer.count);
    return layer.pages;
  }

  // Bind textures of a layer for drawing.
  #drawPages(layer, now) {
    this.#open(layer);
    const { best, pages } = this.wanted(layer);
    layer.pages.use(pages);
    const cells = Math.max(best - 1, 0), { columns, rows } = this.seen(cells, layer);
    const appearing = layer.pages.update(cells, best, columns, rows, now, this.fades);
    layer.pages.bind(UNIT);
    this.#placed(layer, cells);
    return appearing;
  }

  // Set the uniforms of a layer's position.
  #placed(layer, cells) {
    const { gl, places } = this;
    const { width, height } = this.source.form, where = this.#whereabouts(layer);
    const [x, y] = [where.x / (width * 2 ** cells), where.y / (height * 2 ** cells)];
    const turn = (value) => Math.floor(value) - Math.floor(value / CELLS) * CELLS;
    const within = (value, side) => (value - Math.floor(value)) * side;
    gl.uniform4f(places.middle, within(x, width), within(y, height), turn(x), turn(y));
    gl.uniform1f(places.tableScale, 2 ** -cells);
    const [left, top, right, below] = where.bounds.map((end, i) => end - (i % 2 ? where.y : where.x));
    const most = (value) => Math.min(Math.max(value, -3e38), 3e38);
    gl.uniform4f(places.bounds, most(left), most(top), most(right), most(below));
  }

  // Rectangle of the exemplar in the canvas's pixels: left, top, width, height.
  get pieceBox() {
    const { clientWidth, clientHeight } = this.canvas;
    const where = this.#whereabouts(this.piece), [wide, tall] = this.about.piece;
    const scale = Math.max(clientWidth, clientHeight) / this.state.span;
    return [clientWidth / 2 - where.x * scale, clientHeight / 2 - where.y * scale,
      wide * scale, tall * scale];
  }

  // Fit the exemplar to the picture.
  homeward() {
    const { clientWidth, clientHeight } = this.canvas, [wide, tall] = this.about.piece;
    const { x, y } = this.initial();
    const long = Math.max(clientWidth, clientHeight);
    return { x, y, span: long * Math.max(wide / clientWidth, tall / clientHeight) };
  }

  // Values that black and white stand for in the displayed map.
  range() {
    const { map, adjust } = this.state;
    if (!(map in LEAST_RANGE)) return [0, 1];
    const ends = this.pages.range(map);
    if (map === "height") return ends.map((value) => value * Math.max(adjust.relief, 0.01));
    if (map === "roughness") return ends.map((value) => value + adjust.roughness);
    return ends;
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
      const { seed } = this.state, piece = place.layer === this.piece;
      const share = place.layer === this.second ? 1 : this.state.share;
      this.source.load(place, { seed, share, piece }, stop.signal).then(
        (page) => {
          if (this.loading.get(key) !== entry) return; // nobody waits for it any more
          this.loading.delete(key);
          if (place.layer === this.field) this.texelSize = page.texelSize;
          this.#open(place.layer).put(place.level, place.column, place.row, page, performance.now());
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
