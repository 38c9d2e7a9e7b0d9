"""Exported binaries as Babylon.js draws them in Chromium."""

import numpy as np
from chromium import MODULES, camera_of, drawn

PLACE = MODULES / "babylonjs"
_BRIGHTEST = 1000.0  # Babylon.js cuts radiance off at 30, which highlights of metals pass
_PAGE = """<script src="/modules/babylonjs/babylon.js"></script>
<script src="/modules/babylonjs-loaders/babylonjs.loaders.min.js"></script>"""


def render(file, maps, position, intensity, *, widened=True) -> np.ndarray:
    """(H, W, 3) radiance of a .glb under one point light, one texel a pixel.

    Args:
        file: the document.
        maps: for the plane's size; a plane unit is a metre.
        position: of the light.
        intensity: radiant intensity.
        widened: highlights are widened against flicker, as Babylon.js does with glTF.
    """
    about = {"file": file.name, "position": list(position), "intensity": intensity / _BRIGHTEST}
    about["widened"] = widened
    return drawn(_DRAW, about | camera_of(maps), _PAGE, file.parent) * np.float32(_BRIGHTEST)


_DRAW = """async (text) => {
  const about = JSON.parse(text);
  const [width, height] = about.size;
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = about.size;
  const engine = new BABYLON.Engine(canvas, false);
  const scene = new BABYLON.Scene(engine);
  scene.useRightHandedSystem = true;  // as glTF: nothing is turned around
  scene.clearColor = new BABYLON.Color4(0, 0, 0, 1);
  scene.imageProcessingConfiguration.applyByPostProcess = true;  // light, not code values
  await BABYLON.SceneLoader.AppendAsync('/export/', about.file, scene);
  for (const texture of scene.textures) {
    texture.updateSamplingMode(BABYLON.Texture.NEAREST_NEAREST);
  }
  if (!about.widened) {
    for (const material of scene.materials) material.enableSpecularAntiAliasing = false;
  }
  const camera = new BABYLON.FreeCamera('camera', new BABYLON.Vector3(0, 0, about.eye), scene);
  camera.setTarget(BABYLON.Vector3.Zero());
  camera.fov = about.angle * Math.PI / 180;
  [camera.minZ, camera.maxZ] = [0.01, 100];
  scene.activeCamera = camera;
  const light = new BABYLON.PointLight('light', new BABYLON.Vector3(...about.position), scene);
  light.intensityMode = BABYLON.Light.INTENSITYMODE_LUMINOUSINTENSITY;
  light.intensity = about.intensity;
  light.range = 1e9;
  const target = new BABYLON.RenderTargetTexture('picture', {width, height}, scene, {
    type: BABYLON.Constants.TEXTURETYPE_FLOAT, generateMipMaps: false,
    samplingMode: BABYLON.Texture.NEAREST_SAMPLINGMODE,
  });
  target.renderList = scene.meshes.slice();
  target.activeCamera = camera;
  target.clearColor = scene.clearColor;
  await scene.whenReadyAsync();
  while (!target.isReadyForRendering()) await new Promise(done => setTimeout(done, 50));
  target.render();
  const pixels = new Float32Array((await target.readPixels()).buffer);
  let packed = '';
  for (const byte of new Uint8Array(pixels.buffer)) packed += String.fromCharCode(byte);
  return btoa(packed);
}"""
