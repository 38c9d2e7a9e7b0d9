"""Exported binaries and stages as three.js draws them in Chromium."""

import numpy as np
from chromium import MODULES, camera_of, drawn

PLACE = MODULES / "three"
_PAGE = """<script type="importmap">
{"imports": {"three": "/modules/three/build/three.module.js",
             "three/addons/": "/modules/three/examples/jsm/"}}
</script>"""


def render(file, maps, position, intensity, *, plain_normals=False) -> np.ndarray:
    """(H, W, 3) radiance of a .glb or a .usda under one point light, one texel a pixel.

    Args:
        file: the document, its textures beside it.
        maps: for the plane's size; a plane unit is a metre.
        position: of the light.
        intensity: radiant intensity.
        plain_normals: the scale 2 of a stage's texture of normals, which takes [0, 1] to [-1, 1],
            is not taken for their strength too, as three.js does.
    """
    about = {"file": f"/export/{file.name}", "position": list(position), "intensity": intensity}
    about["plain_normals"] = plain_normals
    return drawn(_DRAW, about | camera_of(maps), _PAGE, file.parent)


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
    if (about.plain_normals) one.material.normalScale.set(1, 1);
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
