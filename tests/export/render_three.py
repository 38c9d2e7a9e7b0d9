"""Exported binaries and stages as three.js draws them in Chromium.

Needs playwright, a Chromium, and `npm install --prefix .node three`.
"""

import base64
import json
import shutil
from pathlib import Path

import numpy as np

THREE = Path(__file__).parents[2] / ".node" / "node_modules" / "three"
_PLACE = "http://three.test"
# Software WebGL, which needs no screen.
_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
_PAGE = """<script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script>"""


def render(file, maps, position, intensity) -> np.ndarray:
    """(H, W, 3) radiance of a .glb or a .usda under one point light, one texel a pixel.

    Args:
        file: the document, its textures beside it.
        maps: for the plane's size; a plane unit is a metre.
        position: of the light.
        intensity: radiant intensity.
    """
    from playwright.sync_api import sync_playwright

    width, height = maps.size
    extent = max(width, height) * maps.texel_size
    # three.js gives the angle across the height.
    tall = 2.0 * np.degrees(np.arctan(np.tan(np.radians(22.5)) * height / max(width, height)))
    scene = {
        "file": f"/export/{file.name}",
        "size": [width, height],
        "eye": extent / 2.0 / np.tan(np.radians(22.5)),
        "angle": float(tall),
        "position": list(position),
        "intensity": intensity,
    }  # fmt: skip
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=_FLAGS)
        page = browser.new_page()
        page.route(f"{_PLACE}/**", lambda route: _serve(route, file.parent))
        page.goto(f"{_PLACE}/")
        said = page.evaluate(_DRAW, json.dumps(scene))
        browser.close()
    found = np.frombuffer(base64.b64decode(said), dtype=np.float32).reshape(height, width, 4)
    return found[::-1, :, :3]


def _serve(route, folder) -> None:
    path = route.request.url.removeprefix(_PLACE).split("?")[0]
    if path == "/":
        route.fulfill(body=_PAGE, content_type="text/html")
        return
    place = THREE.parent / path[1:] if path.startswith("/three/") else folder / Path(path).name
    kinds = {".js": "text/javascript", ".png": "image/png"}
    if not place.is_file():
        route.fulfill(status=404)
        return
    kind = kinds.get(place.suffix, "application/octet-stream")
    route.fulfill(body=place.read_bytes(), content_type=kind)


_DRAW = """async (text) => {
  const about = JSON.parse(text);
  const THREE = await import('three');
  const is_usd = about.file.endsWith('.usda');
  const {GLTFLoader} = await import('three/addons/loaders/GLTFLoader.js');
  const {USDLoader} = await import('three/addons/loaders/USDLoader.js');
  const manager = new THREE.LoadingManager();
  let waiting = 0;
  const all = new Promise(done => { manager.onLoad = done; });
  const loaded = is_usd
    ? await new USDLoader(manager).loadAsync(about.file)
    : (await new GLTFLoader(manager).loadAsync(about.file)).scene;
  await Promise.race([all, new Promise(done => setTimeout(done, 3000))]);
  const [width, height] = about.size;
  const renderer = new THREE.WebGLRenderer({canvas: new OffscreenCanvas(width, height)});
  const target = new THREE.WebGLRenderTarget(width, height, {type: THREE.FloatType});
  const scene = new THREE.Scene();
  loaded.rotation.set(0, 0, 0);
  scene.add(loaded);
  loaded.traverse(one => {
    if (!one.isMesh) return;
    for (const value of Object.values(one.material)) {
      if (!value || !value.isTexture) continue;
      value.minFilter = value.magFilter = THREE.NearestFilter;
      value.generateMipmaps = false;
      value.needsUpdate = true;
    }
    one.material.displacementMap = null;
    one.material.needsUpdate = true;
  });
  const light = new THREE.PointLight(0xffffff, about.intensity, 0, 2);
  light.position.set(...about.position);
  scene.add(light);
  const camera = new THREE.PerspectiveCamera(about.angle, width / height, 0.01, 100);
  camera.position.set(0, 0, about.eye);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  await new Promise(done => setTimeout(done, 500));
  renderer.render(scene, camera);
  const pixels = new Float32Array(width * height * 4);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  let packed = '';
  for (const byte of new Uint8Array(pixels.buffer)) packed += String.fromCharCode(byte);
  return btoa(packed);
}"""
