"use strict";
// What is looked at and how, and its picture: state in, pixels out. Knows nothing of controls.

const SHAPES = ["plane", "sphere", "cylinder"];
const MAPS = ["lit", "diffuse", "specular", "roughness", "height", "normal"];
// As the shader has it: a sphere as matcap relight frames it, a cylinder with its whole height.
const ROOM_AROUND = { sphere: 1.25, cylinder: 1.6 };
const FLASH = 1 / Math.tan(Math.PI / 8);

class View {
  // Throws where there is no WebGL2.
  constructor(canvas, about, source) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, source, about });
    // Small devices hold fewer blocks: 96 MB of textures, not 310.
    const small = gl.getParameter(gl.MAX_TEXTURE_SIZE) < 6 * source.side
      || Math.min(screen.width, screen.height) < 700;
    this.slots = small ? 4 : 6;
    this.window = new Window(gl, source.side, this.slots);
    const { program, places } = buildProgram(gl, source.side);
    this.places = places;
    gl.useProgram(program);
    gl.bindVertexArray(gl.createVertexArray());
    ["albedo", "surface", "relief", "presence"].forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.window[name]);
      gl.uniform1i(places[name], unit);
    });
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
    const { side } = this.source;
    return {
      shape: "plane", map: "lit", light: "point", exposure: 0, seed: this.about.seed, share: 0,
      x: side / 2, y: side / 2, // texel in the middle; y downwards
      span: 1.5 * side, // texels across the long side, or a sphere's diameter
      lamp: [-0.35, 0.3, 1], // in units of half the long side, or of the radius
    };
  }

  set(changes) {
    const before = this.state;
    this.state = { ...before, ...changes };
    this.state.span = Math.min(Math.max(this.state.span, 8), this.widest());
    if (before.seed !== this.state.seed || before.share !== this.state.share) {
      for (const { stop } of this.loading.values()) stop.abort();
      this.loading.clear();
      this.window.clear();
    }
    this.failure = "";
    this.redraw();
  }

  // As far away as the window's blocks allow.
  widest() {
    const room = (this.slots - 1) * this.source.side;
    return this.state.shape === "plane" ? room : (2 * room) / Math.PI;
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

  // First and last column and row of blocks that are seen.
  wanted() {
    const { side } = this.source, [across, down] = this.#reach();
    const range = (middle, reach) => [
      Math.floor((middle - reach) / side),
      Math.max(Math.ceil((middle + reach) / side) - 1, Math.floor((middle - reach) / side)),
    ];
    return { columns: range(this.state.x, across), rows: range(this.state.y, down) };
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
    const { columns, rows } = this.wanted();
    const appearing = this.window.update(columns, rows, now, this.fades);
    const whole = this.slots * this.source.side;
    const turn = (value) => value - Math.floor(value / whole) * whole;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.uniform2f(places.size, canvas.width, canvas.height);
    gl.uniform2f(places.centre, turn(state.x), turn(state.y));
    gl.uniform2f(places.texels, this.scale, whole);
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
    return map in LEAST_RANGE ? this.window.range(map) : [0, 1];
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

  // Missing blocks, the nearest to the middle first.
  missing() {
    const { columns, rows } = this.wanted(), { side } = this.source;
    const found = [];
    for (let row = rows[0]; row <= rows[1]; row++) {
      for (let column = columns[0]; column <= columns[1]; column++) {
        if (this.window.has(column, row)) continue;
        const x = (column + 0.5) * side - this.state.x, y = (row + 0.5) * side - this.state.y;
        found.push({ column, row, far: x * x + y * y });
      }
    }
    return found.sort((a, b) => a.far - b.far);
  }

  #fetch() {
    if (this.failure) return;
    for (const { column, row } of this.missing()) {
      if (this.loading.size >= this.source.most) return;
      const key = `${column} ${row}`;
      if (this.loading.has(key)) continue;
      const stop = new AbortController(), entry = { stop };
      this.loading.set(key, entry);
      this.source.load(column, row, this.state.seed, this.state.share, stop.signal).then(
        (block) => {
          if (this.loading.get(key) !== entry) return; // of another seed by now
          this.loading.delete(key);
          this.window.put(column, row, block, performance.now());
          this.redraw();
        },
        (error) => {
          if (this.loading.get(key) !== entry) return;
          this.loading.delete(key);
          this.failure = error instanceof TypeError
            ? "The server does not answer. Is matcap view still running?" : error.message;
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
