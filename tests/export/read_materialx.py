"""MaterialX documents through MaterialX's own library: validity, parameters, a rendered picture."""

import base64

import MaterialX as mx
import numpy as np
from chromium import drawn
from exported import channels, linear, picture
from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader

from matcap.export.shading import TargetSurface


def load(path):
    """The document, MaterialX's own node definitions included."""
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    document = mx.createDocument()
    document.importLibrary(library)
    mx.readFromXmlFile(document, str(path))
    return document


def complaints(path) -> list[str]:
    """What the library finds wrong."""
    valid, said = load(path).validate()
    return [] if valid else [said]


def surface(path) -> TargetSurface:
    """Walks the document: every texture found by following links, none by its name."""
    document = load(path)
    lit = document.getNodeGraph("NG_matcap").getOutput("surface_out").getConnectedNode()
    both = lit.getConnectedNode("bsdf")
    assert both.getCategory() == "add"
    base, gloss = (both.getConnectedNode(name) for name in ("in1", "in2"))
    assert base.getCategory() == "oren_nayar_diffuse_bsdf"
    assert gloss.getCategory() == "generalized_schlick_bsdf"
    for input_, value in (("color82", "1, 1, 1"), ("color90", "1, 1, 1"), ("exponent", "5")):
        assert gloss.getInput(input_).getValueString() == value
    alpha = gloss.getConnectedNode("roughness")
    assert alpha.getCategory() == "roughness_anisotropy"  # the square, MaterialX says
    bent = gloss.getConnectedNode("normal")
    assert bent.getName() == base.getConnectedNode("normal").getName()

    def read(node):
        return channels(_texture(path, node))

    f0 = gloss.getConnectedNode("color0")
    return TargetSurface(
        read(base.getConnectedNode("color")),
        read(f0 if f0.getCategory() == "image" else f0.getConnectedNode("in")),
        read(alpha.getConnectedNode("roughness")),
        2.0 * read(bent.getConnectedNode("in")) - 1.0,
    )


def _texture(path, node) -> np.ndarray:
    """What an image node gives, in the document's own linear space."""
    file = node.getInput("file")
    coded = picture(path.parent / file.getValueString())
    space = file.getColorSpace()
    assert space in ("srgb_texture", "raw")
    assert (space == "srgb_texture") == (node.getType() == "color3")
    return linear(coded) if space == "srgb_texture" else coded


def shader(document, light):
    """The document as GLSL for WebGL2, under one light: "directional" or "point"."""
    generator = PyMaterialXGenGlsl.EsslShaderGenerator.create()
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    context.getOptions().hwMaxActiveLightSources = 1
    kind = document.getNodeDef(f"ND_{light}_light")
    PyMaterialXGenShader.HwShaderGenerator.bindLightShader(kind, 1, context)
    (element,) = PyMaterialXGenShader.findRenderableElements(document)
    return generator.generate("matcap", element, context)


def render(path, maps, light, *, compensated=True) -> np.ndarray:
    """(H, W, 3) radiance as MaterialX's own shader has it, drawn by Chromium.

    Args:
        path: of the .mtlx.
        maps: for the plane's size.
        light: one of matcap's point lights or directional ones.
        compensated: with what bounces between microfacets, which MaterialX adds and matcap's
            diffuse and specular effects leave out.
    """
    document = load(path)
    is_point = hasattr(light, "position")
    made = shader(document, "point" if is_point else "directional")
    # Its point light falls off by the square of a unit more than the distance.
    code = made.getSourceCode(PyMaterialXGenShader.PIXEL_STAGE).replace(
        "distance + 1.0", "distance"
    )
    if not compensated:
        start = code.index("vec3 mx_ggx_energy_compensation(")
        body = code.index("{", start) + 1
        code = code[:body] + " return vec3(1.0);" + code[body:]
    graph = document.getNodeGraph("NG_matcap")
    width, height = maps.size
    textures = {}
    for node in graph.getNodes("image"):
        if node.getName() == "height":
            continue  # it moves the surface, and the plane is not divided
        values = _texture(path, node)
        rgba = np.ones((height, width, 4), dtype=np.float32)
        rgba[..., :3] = values if values.ndim == 3 else values[..., None]
        # GLSL's first row is the lowest.
        textures[f"{node.getName()}_file"] = base64.b64encode(rgba[::-1].tobytes()).decode()
    x, y = width * maps.texel_size / 2.0, height * maps.texel_size / 2.0
    scene = {
        "vertex": made.getSourceCode(PyMaterialXGenShader.VERTEX_STAGE),
        "pixel": code,
        "textures": textures,
        "uniforms": _uniforms(made),
        "size": [width, height],
        "half": [x, y],
        "eye": [0.0, 0.0, max(x, y) / np.tan(np.radians(22.5))],
        "light": [
            ("position", light.position)
            if is_point
            else ("direction", [-c for c in light.direction]),
            ("color", light.intensity if is_point else light.irradiance),
        ],
    }
    return drawn(_DRAW, scene)


def _uniforms(made) -> list:
    """[name, type, value] of what the shader takes beside textures, lights and camera."""
    stage = made.getStage(PyMaterialXGenShader.PIXEL_STAGE)
    block = stage.getUniformBlock("PublicUniforms")
    found = []
    for port in block:
        kind = port.getType().getName()
        if kind in ("float", "integer", "boolean", "vector2", "color3") and port.getValue():
            words = port.getValue().getValueString().split(",")
            numbers = [float(w) if w.strip()[0] not in "tf" else float(w == "true") for w in words]
            found.append([port.getVariable(), kind, numbers])
    return found


_DRAW = """(text) => {
  const scene = JSON.parse(text);
  const [width, height] = scene.size;
  const canvas = new OffscreenCanvas(width, height);
  const gl = canvas.getContext('webgl2');
  if (!gl || !gl.getExtension('EXT_color_buffer_float')) throw new Error('no WebGL2 with floats');
  const program = gl.createProgram();
  const stages = [[gl.VERTEX_SHADER, scene.vertex], [gl.FRAGMENT_SHADER, scene.pixel]];
  for (const [kind, code] of stages) {
    const one = gl.createShader(kind);
    gl.shaderSource(one, code);
    gl.compileShader(one);
    if (!gl.getShaderParameter(one, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(one));
    gl.attachShader(program, one);
  }
  gl.linkProgram(program);
  const linked = gl.getProgramParameter(program, gl.LINK_STATUS);
  if (!linked) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  const at = name => gl.getUniformLocation(program, name);
  for (const [name, kind, values] of scene.uniforms) {
    if (kind === 'integer' || kind === 'boolean') gl.uniform1i(at(name), values[0]);
    else if (kind === 'float') gl.uniform1f(at(name), values[0]);
    else if (kind === 'vector2') gl.uniform2fv(at(name), values);
    else gl.uniform3fv(at(name), values);
  }
  Object.entries(scene.textures).forEach(([name, packed], unit) => {
    const bytes = Uint8Array.from(atob(packed), c => c.charCodeAt(0));
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT,
                  new Float32Array(bytes.buffer));
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.uniform1i(at(name), unit);
  });
  gl.activeTexture(gl.TEXTURE14);  // surroundings: none
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  for (const name of ['u_envRadiance', 'u_envIrradiance']) gl.uniform1i(at(name), 14);
  gl.uniform1i(at('u_envRadianceMips'), 1);
  gl.uniform1i(at('u_envRadianceSamples'), 1);
  const [x, y] = scene.half;
  const one = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
  gl.uniformMatrix4fv(at('u_worldMatrix'), false, one);
  gl.uniformMatrix4fv(at('u_worldInverseTransposeMatrix'), false, one);
  const flat = new Float32Array([1 / x, 0, 0, 0, 0, 1 / y, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
  gl.uniformMatrix4fv(at('u_viewProjectionMatrix'), false, flat);
  gl.uniform3fv(at('u_viewPosition'), scene.eye);
  gl.uniform1i(at('u_numActiveLightSources'), 1);
  gl.uniform1i(at('u_lightData[0].type'), 1);
  for (const [name, value] of scene.light) gl.uniform3fv(at(`u_lightData[0].${name}`), value);
  gl.uniform1f(at('u_lightData[0].intensity'), 1);
  gl.uniform1f(at('u_lightData[0].decay_rate'), 2);
  const attributes = {
    i_position: [3, [-x, -y, 0, x, -y, 0, -x, y, 0, x, y, 0]],
    i_texcoord_0: [2, [0, 0, 1, 0, 0, 1, 1, 1]],
    i_normal: [3, [0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1]],
    i_tangent: [3, [1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0]],
  };
  for (const [name, [size, values]] of Object.entries(attributes)) {
    const place = gl.getAttribLocation(program, name);
    if (place < 0) continue;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
  }
  const target = gl.createTexture();
  gl.activeTexture(gl.TEXTURE15);
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, width, height);
  gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  const pixels = new Float32Array(width * height * 4);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, pixels);
  if (gl.getError() !== gl.NO_ERROR) throw new Error('WebGL failed');
  let packed = '';
  for (const byte of new Uint8Array(pixels.buffer)) packed += String.fromCharCode(byte);
  return btoa(packed);
}"""
