// Reads an environment map from a file to linear radiance, in the form of surroundings.js.

import { linearOf } from "./adjust.js";

const WIDEST_READ = 2048; // texels: what is wider is averaged down, as matcap relight does
const REMEDY = "Give a panorama as .hdr, .exr, .jpg or .png.";

// `decode` sends a file to the server and returns its answer; null without a server.
export async function readSurroundings(file, decode) {
  const kind = file.name.split(".").at(-1).toLowerCase();
  if (kind === "hdr") return readHdr(new Uint8Array(await file.arrayBuffer()));
  if (kind !== "exr") return readCoded(file);
  if (!decode) throw new Error("This page alone reads no .exr. Give .hdr, .jpg or .png.");
  return readServed(await decode(file));
}

async function readServed(answer) {
  if (!answer.ok) throw new Error((await answer.text()).slice(0, 200));
  const [width, height] = JSON.parse(answer.headers.get("X-Size"));
  return { width, height, data: new Float32Array(await answer.arrayBuffer()) };
}

// Formats that the browser decodes, as sRGB; white is radiance 1.
async function readCoded(file) {
  const bitmap = await createImageBitmap(file).catch(() => {
    throw new Error(`${file.name} is no picture that this browser reads. ${REMEDY}`);
  });
  const width = Math.min(bitmap.width, WIDEST_READ);
  const height = Math.max(2, Math.round((bitmap.height * width) / bitmap.width));
  const drawing = new OffscreenCanvas(width, height).getContext("2d");
  drawing.imageSmoothingQuality = "high";
  drawing.drawImage(bitmap, 0, 0, width, height);
  const codes = drawing.getImageData(0, 0, width, height).data;
  const linear = Float32Array.from({ length: 256 }, (_, code) => linearOf(code / 255));
  const data = new Float32Array(3 * width * height);
  for (let i = 0, to = 0; i < codes.length; i += 4, to += 3) {
    for (let c = 0; c < 3; c++) data[to + c] = linear[codes[i + c]];
  }
  return { width, height, data };
}

// Radiance HDR [ward1991]: lines of text, then scanlines of four bytes a pixel, each of the four
// run-length encoded.
export function readHdr(bytes) {
  const wrong = (what) => new Error(`This .hdr file ${what}. ${REMEDY}`);
  let at = 0;
  const line = () => {
    const end = bytes.indexOf(10, at);
    if (end < 0 || end - at > 1000) throw wrong("has no header");
    const text = String.fromCharCode(...bytes.subarray(at, end));
    at = end + 1;
    return text;
  };
  if (!line().startsWith("#?")) throw wrong("is none");
  let exposure = 1; // what the light was multiplied by, as often as it is told
  for (let text = line(); text !== ""; text = line()) {
    if (text.startsWith("EXPOSURE=")) exposure *= Number(text.slice(9));
    if (text.startsWith("FORMAT=") && !text.endsWith("rgbe")) throw wrong("is not stored as RGB");
  }
  if (!(exposure > 0)) throw wrong("has no exposure");
  const [, tall, wide] = /^-Y (\d+) \+X (\d+)$/.exec(line()) || [];
  const [width, height] = [Number(wide), Number(tall)];
  if (!(width > 0 && height > 1 && width * height <= 2 ** 28)) throw wrong("has no size one can read");
  const step = Math.ceil(width / WIDEST_READ), share = 1 / (step * step * exposure);
  const across = Math.floor(width / step), down = Math.floor(height / step);
  const data = new Float32Array(3 * across * down), pixels = new Uint8Array(4 * width);
  for (let row = 0; row < down * step; row++) {
    at = unpackScanline(bytes, at, pixels, width);
    if (at < 0) throw wrong("ends too soon or is damaged");
    for (let column = 0; column < across * step; column++) {
      const exponent = pixels[3 * width + column];
      if (exponent === 0) continue;
      const scale = share * 2 ** (exponent - 136);
      const to = 3 * (Math.floor(row / step) * across + Math.floor(column / step));
      for (let c = 0; c < 3; c++) data[to + c] += pixels[c * width + column] * scale;
    }
  }
  return { width: across, height: down, data };
}

// Decode a scanline into four planes; returns the position of the next one, or -1 if damaged.
function unpackScanline(bytes, at, planes, width) {
  const packed = bytes[at] === 2 && bytes[at + 1] === 2 && (bytes[at + 2] << 8 | bytes[at + 3]) === width;
  if (!packed) {
    if (at + 4 * width > bytes.length) return -1;
    for (let i = 0; i < 4 * width; i++) planes[(i % 4) * width + (i >> 2)] = bytes[at + i];
    return at + 4 * width;
  }
  at += 4;
  for (let plane = 0; plane < 4; plane++) {
    const end = (plane + 1) * width;
    for (let to = plane * width; to < end;) {
      const count = bytes[at] > 128 ? bytes[at] - 128 : bytes[at];
      const run = bytes[at] > 128, from = at + 1;
      at = from + (run ? 1 : count);
      if (!count || to + count > end || at > bytes.length) return -1;
      if (run) planes.fill(bytes[from], to, to + count);
      else planes.set(bytes.subarray(from, at), to);
      to += count;
    }
  }
  return at;
}
