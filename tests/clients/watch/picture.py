"""Draws the pictures of README.md and docs/watch.md: the demo's page at one moment, or in motion.

python tests/clients/watch/picture.py docs/watch.png
python tests/clients/watch/picture.py docs/watch.gif
"""

import io
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from PIL import Image
from playwright.sync_api import Page, sync_playwright

AT_S = 7.0

MOVING_S = (6.1, 9.1)
FRAMES_PER_S = 8


def main(path: str) -> None:
    moving = path.endswith(".gif")
    with _paused_demo() as page:
        if not moving:
            _show(page, AT_S)
            page.wait_for_timeout(1000)
            page.screenshot(path=path)
            return
        first, last = MOVING_S
        count = round((last - first) * FRAMES_PER_S)
        pictures = [_picture(page, first + number / FRAMES_PER_S) for number in range(count)]
    # One palette for all frames, of what is in any of them: colours do not flicker.
    strip = Image.new("RGB", (pictures[0].width, sum(picture.height for picture in pictures)))
    for number, picture in enumerate(pictures):
        strip.paste(picture, (0, number * picture.height))
    palette = strip.quantize(128)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=1000 // FRAMES_PER_S, loop=0, optimize=True
    )


@contextmanager
def _paused_demo() -> Iterator[Page]:
    command = [sys.executable, "-m", "taxel", "watch", "--demo", "--port", "0", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = json.loads(process.stdout.readline())["address"]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
            )
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(address)
            page.wait_for_function("() => window.page?.scene?.traces.predicted", timeout=300_000)
            page.keyboard.press("Space")
            page.evaluate("() => window.page.pickElectrode(14)")
            yield page
            browser.close()
    finally:
        process.terminate()
        process.wait()


def _show(page: Page, at_s: float) -> None:
    page.evaluate("at => window.page.transport.to(at)", at_s)
    page.wait_for_function("at => Math.abs(window.page.shown_s - at) < 0.01", arg=at_s)


def _picture(page: Page, at_s: float) -> Image.Image:
    _show(page, at_s)
    page.wait_for_timeout(200)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return picture.resize((960, 600), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main(sys.argv[1])
