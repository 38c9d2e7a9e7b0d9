"""How fast the page is: python tests/view/time_page.py out/leather [openings].

Serves the material, opens it in headless Chromium with software WebGL at 1280 x 800, and prints, in
seconds from the address's opening: the first picture, and all of it sharp; then how long new pages
take one by one, and the darkest albedo shown in any frame while the view is moved and zoomed.
"""

import os
import shutil
import statistics
import subprocess
import sys
import time

from conftest import FLAGS
from playwright.sync_api import sync_playwright

SIZE = {"width": 1280, "height": 800}
PAGES = """async () => {
  const taken = [];
  for (let i = 0; i < 12; i++) {
    const before = performance.now();
    await (await fetch(`page?level=0&column=${100 + i}&row=77&seed=0&share=0`)).arrayBuffer();
    taken.push(performance.now() - before);
  }
  return taken;
}"""
# Across the plane and out and in again, a step a frame; the lightest channel of the darkest pixel.
FILM = """async () => {
  const { view } = matcap, { gl, canvas } = view, start = view.initial();
  const steps = [];
  for (let i = 1; i <= 12; i++) steps.push({ x: start.x + 150 * i, y: start.y - 60 * i });
  for (let i = 1; i <= 12; i++) steps.push({ span: start.span * 2 ** i });
  for (let i = 11; i >= -6; i--) steps.push({ span: start.span * 2 ** i });
  const codes = new Uint8Array(4 * canvas.width * canvas.height);
  let darkest = 255;
  matcap.set({ map: "diffuse" });
  for (const step of steps) {
    matcap.set(step);
    await new Promise(requestAnimationFrame);
    view.draw(performance.now());
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
    for (let i = 0; i < codes.length; i += 4) {
      const light = Math.max(codes[i], codes[i + 1], codes[i + 2]);
      if (light < darkest) darkest = light;
    }
  }
  return [steps.length, darkest];
}"""


def opened(browser, address):
    """Seconds to the first picture, seconds until it is sharp, and the page."""
    page = browser.new_page(viewport=SIZE, screen=SIZE)
    page.set_default_timeout(600_000)
    start, first = time.perf_counter(), None
    page.goto(address)
    while True:
        state = page.evaluate(
            "window.matcap && [matcap.view.drawn, matcap.view.complete && !matcap.view.pending]"
        )
        now = time.perf_counter() - start
        if state and state[0] and first is None:
            first = now
        if state and state[1]:
            return first, now, page
        time.sleep(0.01)


def main(path, openings=4):
    """Print the figures."""
    command = [sys.executable, "-c", "from matcap.cli.main import run; run()"]
    serving = subprocess.Popen(
        [*command, "view", path, "--no-open", "-q"], stdout=subprocess.PIPE, text=True
    )
    try:
        address = serving.stdout.readline().strip()
        time.sleep(3)
        print("load", *(f"{one:.1f}" for one in os.getloadavg()))
        with sync_playwright() as play:
            program = shutil.which("chromium")
            browser = play.chromium.launch(executable_path=program, args=FLAGS)
            for seed in range(openings):
                first, sharp, page = opened(browser, f"{address}#seed={seed}")
                print(f"opening {seed}: first picture {first:.2f} s, sharp {sharp:.2f} s")
                if seed + 1 < openings:
                    page.close()
            taken = page.evaluate(PAGES)
            print(f"new page: median {statistics.median(taken):.0f} ms, most {max(taken):.0f} ms")
            frames, darkest = page.evaluate(FILM)
            print(f"film of {frames} frames: darkest code {darkest} of 255")
            browser.close()
        print("load", *(f"{one:.1f}" for one in os.getloadavg()))
    finally:
        serving.terminate()
        serving.wait()


if __name__ == "__main__":
    main(sys.argv[1], *(int(one) for one in sys.argv[2:]))
