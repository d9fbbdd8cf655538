"""The page in a real browser: what is drawn, read back and compared with the data."""

import io
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from taxel.channels import ELECTRODE_COLUMNS
from taxel_watch.colours import LIMIT
from taxel_watch.replay import Replay
from taxel_watch.scene import Source

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium on this machine (on Debian: apt install chromium)"
)

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update", "--force-color-profile=srgb"]
PATIENCE_MS = 30_000


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def opened(
    browser: Browser, serve: Callable[[Source], str], paced: Replay
) -> Iterator[Callable[..., Page]]:
    """Opens the page of two fingertips; it must not fail, and must not ask anybody else."""
    address = serve(paced)
    contexts, faults = [], []

    def open_page(width: int = 1440, height: int = 900, scheme: Any = "light") -> Page:
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda text: faults.append(text.text) if text.type == "error" else None)
        page.on(
            "request",
            lambda request: None if request.url[4:].startswith(address[4:]) else faults.append(request.url),
        )
        page.goto(address)
        page.wait_for_function("() => window.page?.scene && window.page.pasts.get('0')?.time.length")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not faults


def seek(page: Page, seconds: float) -> None:
    """Move the scrubber, and wait until that moment is drawn, numbers included."""
    page.evaluate(
        """seconds => {
            const slider = document.getElementById("seek");
            slider.value = seconds;
            slider.dispatchEvent(new Event("input"));
        }""",
        seconds,
    )
    wait_until_at(page, seconds)


def wait_until_at(page: Page, seconds: float) -> None:
    page.wait_for_function("seconds => Math.abs(window.page.shown_s - seconds) < 0.005", arg=seconds)
    # Numbers are written at most eight times in a second: let the last of them come.
    page.wait_for_function("() => window.page.later === null")


def screenshot(page: Page, selector: str) -> np.ndarray[Any, Any]:
    """(height, width, 3) pixels of an element."""
    png = page.locator(selector).screenshot()
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def fills(page: Page, view: str) -> np.ndarray[Any, Any]:
    """(19, 3) the colours of a map's cells, as the browser computes them."""
    texts = page.eval_on_selector_all(
        f'figure[data-view="{view}"] .cell', "cells => cells.map(cell => getComputedStyle(cell).fill)"
    )
    return np.array([[int(part) for part in text[4:-1].split(",")] for text in texts])


def less_rest(replay: Replay, finger: int, row: int) -> Any:
    recording = replay.recordings[finger]
    return (recording.channels[row] - recording.channels[0])[ELECTRODE_COLUMNS]


def legend_colours(page: Page, values: Any) -> Any:
    """The legend's pixels where it shows these values: the root of a share of its half."""
    bar = screenshot(page, "#legend canvas")
    shares = np.sign(values) * np.sqrt(np.minimum(np.abs(values), LIMIT) / LIMIT)
    columns = np.rint((shares + 1) / 2 * (bar.shape[1] - 1)).astype(int)
    return bar[bar.shape[0] // 2, np.clip(columns, 2, bar.shape[1] - 3)]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_cells_have_the_legends_colour_of_their_counts(
    opened: Callable[..., Page], paced: Replay, scheme: str
) -> None:
    page = opened(scheme=scheme)
    page.keyboard.press("Space")
    seek(page, 4.5)
    values = less_rest(paced, 0, 450)
    assert values.min() < -600 < 200 < values.max()
    np.testing.assert_allclose(fills(page, "measured"), legend_colours(page, values), atol=8)
    np.testing.assert_allclose(fills(page, "predicted"), legend_colours(page, values - 60), atol=8)
    np.testing.assert_allclose(fills(page, "residual"), legend_colours(page, np.full(19, 60)), atol=8)
    np.testing.assert_allclose(
        fills(page, "residual, corrected"), legend_colours(page, np.full(19, 8)), atol=8
    )


def test_cells_tell_their_counts_and_what_is_drawn_is_their_colour(
    opened: Callable[..., Page], paced: Replay
) -> None:
    page = opened()
    page.keyboard.press("Space")
    seek(page, 5.0)
    told = page.locator('figure[data-view="measured"] text.value').all_text_contents()
    shown = [int(text.replace("\N{MINUS SIGN}", "-")) for text in told]
    np.testing.assert_allclose(shown, less_rest(paced, 0, 500), atol=0.51)
    for electrode in (1, 6, 16):
        cell = f'figure[data-view="measured"] g[data-channel="e{electrode}"] .cell'
        pixels = screenshot(page, cell).reshape(-1, 3)
        near = (np.abs(pixels - fills(page, "measured")[electrode - 1]) <= 4).all(axis=1)
        assert near.mean() > 0.3, f"e{electrode}"


def test_where_nothing_is_predicted_nothing_is_coloured(opened: Callable[..., Page]) -> None:
    page = opened()
    page.keyboard.press("Space")
    seek(page, 0.05)
    filled = page.eval_on_selector_all(
        'figure[data-view="predicted"] .cell', "cells => cells.map(cell => getComputedStyle(cell).fill)"
    )
    assert set(filled) == {"none"}
    assert page.locator('figure[data-view="predicted"] text.value').first.text_content() == "\N{EN DASH}"


def test_the_contact_is_where_it_is_recorded_and_grows_with_the_force(opened: Callable[..., Page]) -> None:
    page = opened()
    page.keyboard.press("Space")
    ring = page.locator('figure[data-view="measured"] .contact circle').last
    seek(page, 0.5)
    assert ring.locator("..").get_attribute("visibility") == "hidden"
    seek(page, 2.5)
    small = float(ring.get_attribute("r") or 0)
    # 6 mm behind the seam; 1.5 mm to the side is 12.4 degrees of a skin of 7 mm.
    assert float(ring.get_attribute("cx") or 0) == pytest.approx(7 * np.arctan2(1.5, 6.8), abs=0.01)
    assert float(ring.get_attribute("cy") or 0) == pytest.approx(6.0, abs=0.01)
    seek(page, 5.5)
    assert float(ring.get_attribute("r") or 0) > 1.3 * small
    force = np.linalg.norm([0.1, 0.2, 1.0]) * 450 / 200
    assert page.locator("#readings dd").first.inner_text() == f"{force:.2f} N"


def colour(page: Page, name: str) -> Any:
    text = page.evaluate(
        "name => getComputedStyle(document.documentElement).getPropertyValue('--' + name)", name
    )
    return np.array([int(text.strip()[at : at + 2], 16) for at in (1, 3, 5)])


def line_of(pixels: Any, wanted: Any) -> tuple[Any, Any]:
    """Columns and rows of the pixels that have nearly a colour."""
    rows, columns = np.nonzero((np.abs(pixels - wanted) <= 40).all(axis=2))
    return columns, rows


def test_the_strip_charts_draw_the_last_seconds(opened: Callable[..., Page]) -> None:
    page = opened()
    page.keyboard.press("Space")
    seek(page, 5.9)
    # The second chart is pdc: flat for a second, then it rises by 120 counts in 2 s; predicted is 60 lower.
    pixels = screenshot(page, ".chart:nth-child(2) canvas")
    columns, rows = line_of(pixels, colour(page, "predicted"))
    assert len(columns) > 50
    right, left = columns > np.quantile(columns, 0.9), columns < np.quantile(columns, 0.1)
    assert rows[right].mean() < rows[left].mean() - 10
    # Nothing is drawn of the time before the recording began: the charts show 10 s.
    assert columns.min() > 0.3 * pixels.shape[1]
    blank = screenshot(page, ".chart:nth-child(2) canvas")
    seek(page, 0.2)
    assert (screenshot(page, ".chart:nth-child(2) canvas") != blank).any()


def test_light_and_dark_follow_the_system_and_the_reader(opened: Callable[..., Page]) -> None:
    page = opened(scheme="dark")
    lightness = "() => getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)[0]"
    assert page.evaluate(lightness) < 60
    dark = fills(page, "measured")
    page.keyboard.press("t")
    assert page.evaluate(lightness) > 200
    assert (fills(page, "measured") != dark).any()
    page.reload()
    page.wait_for_function("() => window.page?.scene")
    assert page.evaluate(lightness) > 200
    assert opened(scheme="light").evaluate(lightness) > 200


def test_the_keyboard_plays_steps_and_chooses(opened: Callable[..., Page], paced: Replay) -> None:
    page = opened()
    page.keyboard.press("Space")
    page.wait_for_selector("#status dd:text-is('paused')")
    page.keyboard.press("End")
    wait_until_at(page, 5.99)
    page.keyboard.press("ArrowLeft")
    wait_until_at(page, 5.98)
    page.keyboard.press("Shift+ArrowLeft")
    wait_until_at(page, 4.98)
    page.keyboard.press("]")
    assert page.evaluate("window.page.electrode") == 17
    assert (
        page.locator('figure[data-view="measured"] g[aria-pressed="true"]').get_attribute("data-channel")
        == "e18"
    )
    page.keyboard.press("2")
    page.wait_for_function("() => window.page.later === null")
    assert page.locator('#fingers button[aria-pressed="true"] b').inner_text() == "index"
    told = page.locator('figure[data-view="measured"] text.value').first.text_content() or ""
    assert int(told.replace("\N{MINUS SIGN}", "-")) == round(less_rest(paced, 1, 498)[0])
    page.keyboard.press("?")
    assert page.locator("dialog[open]").is_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("Home")
    wait_until_at(page, 0.0)
    page.keyboard.press("Space")
    page.wait_for_selector("#status dd:text-is('playing')")


def test_a_click_chooses_an_electrode_for_the_charts(opened: Callable[..., Page]) -> None:
    page = opened()
    page.locator('figure[data-view="predicted"] g[data-channel="e5"] .cell').click()
    page.wait_for_selector(".chart .name:text('electrode e5')")
    assert page.evaluate("window.page.electrode") == 4


def test_nothing_moves_once_a_moment_is_shown(opened: Callable[..., Page]) -> None:
    page = opened()
    first = page.locator('figure[data-view="predicted"]').bounding_box()
    page.wait_for_selector("#status dd:text-is('playing')")
    page.wait_for_function("() => window.page.later === null")
    assert page.locator('figure[data-view="predicted"]').bounding_box() == first


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900)])
def test_everything_fits(opened: Callable[..., Page], width: int, height: int) -> None:
    page = opened(width, height)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    sizes = page.eval_on_selector_all(
        "figure svg, .chart canvas",
        "all => all.map(one => one.getBoundingClientRect()).map(b => [b.width, b.height])",
    )
    assert len(sizes) == 10
    assert np.min(sizes) >= 60
    if width > 900:
        assert page.evaluate("document.documentElement.scrollHeight") <= height
    else:
        bar = page.locator("#transport").bounding_box()
        assert bar is not None
        assert bar["y"] + bar["height"] == pytest.approx(height, abs=1)


def test_a_busy_page_gets_the_newest_moment_when_it_is_back(
    opened: Callable[..., Page], paced: Replay, clock: Any
) -> None:
    paced.loops = True
    page = opened()
    page.evaluate(
        "() => { const stream = window.page.stream; stream.real = stream.say; stream.say = () => {}; }"
    )
    # Moments that are still on their way arrive first.
    same = 0
    while same < 10:
        stuck = page.evaluate("window.page.shown_s")
        clock.now += 0.1
        page.wait_for_timeout(20)
        same = same + 1 if page.evaluate("window.page.shown_s") == stuck else 0
    for _ in range(20):
        clock.now += 0.1
        page.wait_for_timeout(20)
    assert page.evaluate("window.page.shown_s") == stuck
    assert abs(clock.now % 6.0 - stuck) > 0.1
    page.evaluate(
        "() => { const s = window.page.stream; s.say = s.real; s.say('drawn', 1); s.say('drawn', 2); }"
    )
    page.wait_for_function("at => Math.abs(window.page.shown_s - at) < 0.02", arg=clock.now % 6.0)
    assert page.evaluate("window.page.pasts.get('0').time.length") > 250


def test_a_lost_server_is_told_and_found_again(opened: Callable[..., Page]) -> None:
    page = opened()
    page.evaluate(
        "() => { const s = window.page.stream; s.real = s.open; s.open = () => {}; s.socket.close(); }"
    )
    page.wait_for_selector("#note:text('does not answer')")
    page.evaluate("() => window.page.stream.real()")
    page.wait_for_selector("#status dd:text-is('playing')")
    assert page.locator("#note").is_hidden()
