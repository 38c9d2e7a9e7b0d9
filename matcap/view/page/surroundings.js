// Environment lighting for the shader: an equirectangular picture of radiance, oriented as in
// matcap relight (top +y, middle +z, right half towards -x), with its mip levels, and irradiance by
// normal.

const AROUND = 64; // normals of the irradiance, half as many from pole to pole
const SUMMED = 128; // texels across that it is summed over, at most

// Direction of a position in the picture, both coordinates from 0 to 1.
export function directionOf(u, v) {
  const azimuth = 2 * Math.PI * (u - 0.5), polar = Math.PI * v, ring = Math.sin(polar);
  return [-Math.sin(azimuth) * ring, Math.cos(polar), Math.cos(azimuth) * ring];
}

export class Surroundings {
  // A picture is {width, height, data}: rows from the top, three floats a texel.
  constructor(gl, picture) {
    const levels = [picture];
    while (levels.at(-1).height >= 8) levels.push(smaller(levels.at(-1)));
    const few = levels.find(({ width }) => width <= SUMMED) || levels.at(-1);
    this.radiance = this.#texture(gl, levels);
    this.irradiance = this.#texture(gl, [irradianceOf(few)]);
  }

  // Bind the textures.
  use(gl, units) {
    gl.activeTexture(gl.TEXTURE0 + units.radiances);
    gl.bindTexture(gl.TEXTURE_2D, this.radiance);
    gl.activeTexture(gl.TEXTURE0 + units.irradiances);
    gl.bindTexture(gl.TEXTURE_2D, this.irradiance);
    gl.activeTexture(gl.TEXTURE0 + units.spare);
  }

  #texture(gl, levels) {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texStorage2D(gl.TEXTURE_2D, levels.length, gl.RGB16F, levels[0].width, levels[0].height);
    levels.forEach(({ width, height, data }, level) => {
      gl.texSubImage2D(gl.TEXTURE_2D, level, 0, 0, width, height, gl.RGB, gl.FLOAT, data);
    });
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER,
      levels.length > 1 ? gl.LINEAR_MIPMAP_NEAREST : gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }
}

// Averages of 2 x 2 texels; an odd last row or column is dropped.
function smaller({ width, height, data }) {
  const wide = width >> 1, tall = height >> 1, half = new Float32Array(3 * wide * tall);
  for (let row = 0, to = 0; row < tall; row++) {
    for (let column = 0; column < wide; column++, to += 3) {
      const upper = 3 * (2 * row * width + 2 * column), lower = upper + 3 * width;
      for (let c = 0; c < 3; c++) {
        half[to + c] = 0.25
          * (data[upper + c] + data[upper + 3 + c] + data[lower + c] + data[lower + 3 + c]);
      }
    }
  }
  return { width: wide, height: tall, data: half };
}

// Solid angle of a texel by row.
function solidAngle({ width, height }, row) {
  const edge = (line) => Math.cos((Math.PI * line) / height);
  return ((edge(row) - edge(row + 1)) * 2 * Math.PI) / width;
}

// Spherical harmonics would be shorter, but a tenth off at a low sun.
function irradianceOf(picture) {
  const count = picture.width * picture.height;
  const towards = new Float32Array(3 * count), power = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const row = Math.floor(i / picture.width), column = i - row * picture.width;
    const solid = solidAngle(picture, row);
    towards.set(directionOf((column + 0.5) / picture.width, (row + 0.5) / picture.height), 3 * i);
    for (let c = 0; c < 3; c++) power[3 * i + c] = picture.data[3 * i + c] * solid;
  }
  const width = AROUND, height = AROUND / 2, data = new Float32Array(3 * width * height);
  for (let place = 0; place < width * height; place++) {
    const row = Math.floor(place / width), column = place - row * width;
    const [x, y, z] = directionOf((column + 0.5) / width, (row + 0.5) / height);
    let red = 0, green = 0, blue = 0;
    for (let i = 0; i < 3 * count; i += 3) {
      const cosine = x * towards[i] + y * towards[i + 1] + z * towards[i + 2];
      if (cosine <= 0) continue;
      red += cosine * power[i];
      green += cosine * power[i + 1];
      blue += cosine * power[i + 2];
    }
    data.set([red, green, blue], 3 * place);
  }
  return { width, height, data };
}

export const SURROUNDINGS_GLSL = `
uniform sampler2D radiances;    // latitude by longitude
uniform sampler2D irradiances;  // likewise, of normals

vec2 placeOf(vec3 d) {
  float z = abs(d.z) < 1e-9 ? 1e-9 : d.z; // at the poles any longitude will do
  return vec2(atan(-d.x, z) * 0.5 / PI + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
}

// Radiance from a direction, averaged over about a solid angle; 0 for a single texel.
vec3 radianceFrom(vec3 d, float solid) {
  vec2 texels = vec2(textureSize(radiances, 0));
  float texel = 2.0 * PI * PI / (texels.x * texels.y); // at the equator
  return textureLod(radiances, placeOf(d), 0.5 * log2(max(solid / texel, 1.0))).rgb;
}

vec3 irradianceOn(vec3 n) {
  return textureLod(irradiances, placeOf(n), 0.0).rgb;
}`;
