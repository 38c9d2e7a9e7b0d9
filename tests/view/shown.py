"""What the page shows in a browser, and what relight draws of the same."""

import base64
import io
import math

import numpy as np
from PIL import Image

from matcap.api import relight
from matcap.files.exr import write_exr
from matcap.relight.render import encode
from matcap.relight.scene import Camera, EnvironmentLight, Film, PointLight, Scene, Surface

# What the page does, and nothing of what it says it does not.
EFFECTS = "all,-multiscatter,-parallax,-shadows,-visibility,-interreflection"
WIDTH, HEIGHT = 320, 240
LAMP = (-0.4, 0.25, 0.9)
STEP = 1 / 255


def picture(tab, **state):
    """(HEIGHT, WIDTH, 3) codes from 0 to 1 of what the page shows in a state."""
    tab.until("!!window.matcap")
    tab.ask("size => Object.assign(matcap.view.canvas, size)", {"width": WIDTH, "height": HEIGHT})
    tab.ask("state => matcap.set({...matcap.view.initial(), ...state})", state)
    tab.loaded()
    data = tab.ask(
        """async () => {
          const bytes = new Uint8Array(await (await matcap.view.picture()).arrayBuffer());
          return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
        }"""
    )
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")) / 255.0


def expected(maps, shape, span, exposure=0.0, lights=None, lamp=LAMP):
    """The same by relight, maps around the middle of the view; and where the surface is."""
    unit = span / 2 * maps.texel_size
    place, away = lamp, lamp[2]
    if shape != "plane":
        place = (lamp[0], lamp[1], lamp[2] + 1)
        away = math.hypot(*place) - 1
    strength = math.pi * away**2 * unit**2
    light = PointLight(tuple(c * unit for c in place), (strength,) * 3)
    film = Film(WIDTH, HEIGHT, exposure)
    camera = None
    if shape == "cylinder":  # relight's own camera crops it
        camera = Camera(position=(0.0, 0.0, 1.6 * WIDTH / HEIGHT * unit / math.tan(math.pi / 8)))
    scene = Scene(film, camera, Surface(shape, size=2 * unit), lights or (light,))
    radiance = relight(maps, scene, effects=EFFECTS)
    return encode(radiance, film), radiance.max(axis=2) > 0


def around(material, x, y, side=1024, **which):
    return material.maps(side, side, x=x - side // 2, y=y - side // 2, **which)


def inner(mask, by=2):
    """Without the outline, where a pixel's own footprint grows without bound."""
    for axis in (0, 1):
        mask = mask & np.roll(mask, by, axis) & np.roll(mask, -by, axis)
    return mask


def all_around(rows, columns):
    """(rows, columns, 3) directions of the texels of a picture of surroundings."""
    latitude = (0.5 - (np.arange(rows) + 0.5) / rows)[:, None] * math.pi
    # The middle is +z, the right half towards -x (relight/scene.py).
    longitude = -((np.arange(columns) + 0.5) / columns - 0.5)[None, :] * 2 * math.pi
    parts = (
        np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)
    )  # fmt: skip
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def room_light(tab, name, path):
    """The light of one of the page's rooms for relight, by a file."""
    directions = all_around(128, 256)
    light = tab.ask(
        "([name, all]) => all.map((d) => matcap.room(name, d))",
        [name, directions.reshape(-1, 3).tolist()],
    )
    write_exr(path, np.float32(light).reshape(directions.shape), half=False)
    return (EnvironmentLight(file=path),)
