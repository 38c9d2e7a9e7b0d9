// What is looked at and how, and its picture: state in, pixels out. Knows nothing of controls.

import { CELLS, LEAST_RANGE, Pages } from "./pages.js";
import { buildProgram } from "./shader.js";
import { roomHarmonics } from "./surroundings.js";

const SHAPES = ["plane", "sphere", "cylinder"];
export const MAPS = ["lit", "diffuse", "specular", "roughness", "height", "normal"];
// As the shader has it: a sphere as matcap relight frames it, a cylinder with its whole height.
const ROOM_AROUND = { sphere: 1.25, cylinder: 1.6 };
export const FLASH = 1 / Math.tan(Math.PI / 8);
const NEAREST = 4, FARTHEST = 2 ** 30; // texels across
const FARTHEST_LEVEL = 21;
const COARSER = 3; // levels between what is sharp and what comes first
const SPARE = 12; // pages kept for coarse forms and for what was just seen
export const GONE = "The server does not answer. Is matcap view still running?";

export class View {
  // Throws where there is no WebGL2.
  constructor(canvas, about, source) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, source, about });
    // Small devices hold fewer pages: 130 MB of textures, not 320.
    const small = Math.min(screen.width, screen.height) < 700;
    this.pages = new Pages(gl, source.form, small ? 26 : 64);
    const { program, places } = buildProgram(gl, source.form);
    this.places = places;
    gl.useProgram(program);
    gl.bindVertexArray(gl.createVertexArray());
    ["albedo", "surface", "relief", "table"].forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      const kind = name === "table" ? gl.TEXTURE_2D : gl.TEXTURE_2D_ARRAY;
      gl.bindTexture(kind, this.pages[name]);
      gl.uniform1i(places[name], unit);
    });
    const mean = about.mean;
    gl.uniform4f(places.meanAlbedo, ...mean.slice(0, 4));
    gl.uniform4f(places.meanSurface, mean[4], 0, 0, mean[7]);
    gl.activeTexture(gl.TEXTURE4); // uploads bind here, and leave the four alone
    gl.uniform3fv(places.harmonics, roomHarmonics());
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
      lamp: [-0.35, 0.3, 1], // in units of half the long side, or of the radius
    };
  }

  set(changes) {
    const before = this.state;
    this.state = { ...before, ...changes };
    this.state.span = Math.min(Math.max(this.state.span, NEAREST), FARTHEST);
    if (before.seed !== this.state.seed || before.share !== this.state.share) {
      for (const { stop } of this.loading.values()) stop.abort();
      this.loading.clear();
      this.pages.clear();
    }
    this.failure = "";
    this.redraw();
  }

  // Texels to a unit.
  get scale() {
    return this.state.span / 2;
  }

  // Half of what the picture shows, in texels.
  #reach() {
    const { width, height } = this.canvas, long = Math.max(width, height);
    if (this.state.shape === "plane") return [width / long, height / long].map((v) => v * this.scale);
    const upwards = this.state.shape === "sphere" ? Math.PI / 2 : 1;
    return [(this.scale * Math.PI) / 2, this.scale * upwards];
  }

  // How many times the finest texels must be halved to be no smaller than pixels.
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

  // First and last column and row of pages of a level that are seen, and so many texels around.
  seen(level, around = 0) {
    const { width, height } = this.source.form, [across, down] = this.#reach();
    const range = (middle, reach, side) => {
      const first = Math.floor((middle - reach - around) / side);
      return [first, Math.max(Math.ceil((middle + reach + around) / side) - 1, first)];
    };
    return {
      columns: range(this.state.x, across, width * 2 ** level),
      rows: range(this.state.y, down, height * 2 ** level),
    };
  }

  #listed(level, around) {
    const { width, height } = this.source.form, { columns, rows } = this.seen(level, around);
    const found = [];
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        const x = (column + 0.5) * width * 2 ** level - this.state.x;
        const y = (row + 0.5) * height * 2 ** level - this.state.y;
        found.push({ level, column, row, far: x * x + y * y });
      }
    }
    return found.sort((a, b) => a.far - b.far);
  }

  // Pages of what is seen, in the order they are wanted: a coarse form of everything, then what is
  // sharp, the nearest to the middle first. `best` is the level of the sharp ones: coarser than it
  // should be where there is no room for all of them.
  wanted() {
    let best = this.level;
    while (this.#count(best) > this.pages.count - SPARE && best < FARTHEST_LEVEL) best += 1;
    const coarse = this.#listed(Math.min(best + COARSER, FARTHEST_LEVEL), 0);
    return { best, pages: [...coarse, ...this.#listed(best, 0)] };
  }

  #count(level) {
    const { columns, rows } = this.seen(level);
    return (columns[1] - columns[0] + 1) * (rows[1] - rows[0] + 1);
  }

  redraw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame((now) => {
      this.pending = 0;
      this.#fetch();
      if (this.draw(now)) this.redraw();
      this.changed();
    });
  }

  // Draw now; true while something is still appearing.
  draw(now = Infinity) {
    const { gl, places, state, canvas } = this;
    const { best, pages } = this.wanted();
    this.pages.use(pages);
    const cells = Math.max(best - 1, 0), { columns, rows } = this.seen(cells);
    const appearing = this.pages.update(cells, best, columns, rows, now, this.fades);
    const { width, height } = this.source.form;
    const [x, y] = [state.x / (width * 2 ** cells), state.y / (height * 2 ** cells)];
    const turn = (value) => Math.floor(value) - Math.floor(value / CELLS) * CELLS;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.uniform2f(places.size, canvas.width, canvas.height);
    const within = (value, side) => (value - Math.floor(value)) * side;
    gl.uniform4f(places.middle, within(x, width), within(y, height), turn(x), turn(y));
    gl.uniform1f(places.texels, this.scale);
    gl.uniform1f(places.tableScale, 2 ** -cells);
    gl.uniform1i(places.shape, SHAPES.indexOf(state.shape));
    gl.uniform1i(places.map, MAPS.indexOf(state.map));
    gl.uniform1i(places.room, state.light === "room" ? 1 : 0);
    const { place, intensity } = this.lamp();
    gl.uniform3f(places.lightPlace, ...place);
    gl.uniform1f(places.intensity, intensity);
    gl.uniform1f(places.gain, 2 ** state.exposure);
    gl.uniform2f(places.range, ...this.range());
    gl.uniformMatrix3fv(places.turned, false, this.#turned());
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    this.drawn += 1;
    return appearing;
  }

  // What black and white mean in the map shown.
  range() {
    const { map } = this.state;
    return map in LEAST_RANGE ? this.pages.range(map) : [0, 1];
  }

  // What the picture shows at the surface's middle, in units: half its long side.
  get spread() {
    if (this.state.shape === "plane") return 1;
    const { width, height } = this.canvas;
    return (ROOM_AROUND[this.state.shape] * Math.max(width, height)) / Math.min(width, height);
  }

  // Where the lamp is and its radiant intensity: white shows as white where it is nearest.
  lamp() {
    const [x, y, z] = this.state.lamp;
    if (this.state.shape === "plane") return { place: [x, y, z], intensity: Math.PI * z * z };
    const place = [x, y, z + 1]; // counted from the nearest point of the surface
    const away = Math.max(Math.hypot(...place) - 1, 0.05);
    return { place, intensity: Math.PI * away * away };
  }

  // The room turns with the pointer, about y and then x; columns of scene to room.
  #turned() {
    const [x, y] = this.state.lamp;
    const [sx, cx] = [Math.sin(x + 0.35), Math.cos(x + 0.35)];
    const [sy, cy] = [Math.sin(y - 0.3), Math.cos(y - 0.3)];
    return [cx, sy * sx, cy * sx, 0, cy, -sy, -sx, sy * cx, cy * cx];
  }

  // Pages of what is seen that are not there, in the order they are asked for.
  missing() {
    return this.wanted().pages.filter(
      ({ level, column, row }) => !this.pages.has(level, column, row),
    );
  }

  #fetch() {
    const missing = this.missing();
    const keys = new Set(missing.map(({ level, column, row }) => Pages.key(level, column, row)));
    for (const [key, { stop }] of this.loading) {
      if (keys.has(key)) continue;
      stop.abort(); // it has left the view
      this.loading.delete(key);
    }
    if (this.failure) return;
    for (const place of missing) {
      if (this.loading.size >= this.source.most) return;
      const key = Pages.key(place.level, place.column, place.row);
      if (this.loading.has(key)) continue;
      const stop = new AbortController(), entry = { stop };
      this.loading.set(key, entry);
      this.source.load(place, this.state.seed, this.state.share, stop.signal).then(
        (page) => {
          if (this.loading.get(key) !== entry) return; // nobody waits for it any more
          this.loading.delete(key);
          this.texelSize = page.texelSize;
          this.pages.put(place.level, place.column, place.row, page, performance.now());
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

  // All that is seen has been loaded.
  get complete() {
    return this.missing().length === 0;
  }

  // What is shown, as a PNG.
  picture() {
    this.draw();
    return new Promise((done) => { this.canvas.toBlob(done, "image/png"); });
  }
}
