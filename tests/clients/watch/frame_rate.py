"""Counts how often the demo's page is drawn in headless Chromium, at the size of a desktop and of a phone.

    python tests/clients/watch/frame_rate.py > docs/results/frame_rate.json

The demo plays 100 rows a second. Chromium draws without a graphics card here, on the machine's own cores.
"""

import json
import os

import numpy as np
from picture import _paused_demo

SIZES = {"desktop": (1440, 900), "phone": (390, 844)}
SECONDS = 20.0

_COUNT = """() => {
  const times = (window.drawn = []), handlers = window.page.stream.handlers, frames = handlers.frames;
  handlers.frames = (newest) => { frames(newest); times.push(performance.now()); };
}"""


def main() -> None:
    told = {}
    with _paused_demo() as page:
        page.evaluate(_COUNT)
        page.keyboard.press("Space")
        for name, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_timeout(2000)
            page.evaluate("() => { window.drawn.length = 0; }")
            page.wait_for_timeout(SECONDS * 1000)
            between = np.diff(page.evaluate("() => window.drawn"))
            told[name] = {
                "frames_per_s": round(1000 / between.mean(), 2),
                "between_ms": {
                    share: round(float(np.quantile(between, at)), 1)
                    for share, at in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
                },
            }
    print(json.dumps({"load": round(os.getloadavg()[0], 2), "cores": os.cpu_count(), **told}, indent=1))


if __name__ == "__main__":
    main()
