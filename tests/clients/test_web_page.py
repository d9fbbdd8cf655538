"""The client for web pages, in a real browser: a page asks a live server, and gets Python's numbers."""

import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, sync_playwright

import taxel
from taxel_bench.server_process import free_port, running_server
from taxel_models.shipped import shipped_repository

CLIENT = Path(__file__).resolve().parents[2] / "clients" / "typescript"
COMPILER = CLIENT / "node_modules" / ".bin" / "tsc"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ANOTHER_SITE = "another.example"

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="no Chromium on this machine (on Debian: apt install chromium)"
    ),
    pytest.mark.skipif(
        shutil.which("node") is None or not COMPILER.exists(),
        reason="no TypeScript compiler: run npm ci in clients/typescript",
    ),
]

ASK = """async ([address, windows]) => {
  const { Source } = await import("/src/browser.js");
  const source = new Source(address, { timeoutMs: 20000 });
  const part = (i) => source.infer("xgb", windows.slice(16 * i, 16 * i + 16));
  const replies = await Promise.all([0, 1, 2, 3].map(part));
  source.close();
  return replies.flatMap(({ channels }) => channels).flatMap((row) => [...new Uint8Array(row.buffer)]);
}"""

FAIL = """async ([address, model]) => {
  const { Source, TaxelError } = await import("/src/browser.js");
  const source = new Source(address, { timeoutMs: 20000 });
  try {
    await source.infer(model, [new Float32Array(12)]);
  } catch (error) {
    return [error instanceof TaxelError, error.name, error.code, error.message];
  } finally {
    source.close();
  }
}"""


class _Handler(SimpleHTTPRequestHandler):
    """The compiled client, and an empty page."""

    def do_GET(self) -> None:
        if self.path != "/":
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><link rel=icon href='data:,'>")

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page of somebody's own."""
    built = tmp_path_factory.mktemp("client")
    subprocess.run([str(COMPILER), "--outDir", str(built)], cwd=CLIENT, check=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=str(built)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(scope="module")
def page(site: str) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM,
            args=[
                "--no-sandbox",
                "--disable-gpu",
                "--disable-background-networking",
                f"--host-resolver-rules=MAP {ANOTHER_SITE} 127.0.0.1",
            ],
        )
        opened = browser.new_page()
        opened.goto(site)
        yield opened
        browser.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """A server of the shipped trees: its endpoint, and its address for pages."""
    repository = tmp_path_factory.mktemp("repository")
    shutil.copytree(shipped_repository() / "xgb", repository / "xgb")
    place = f"127.0.0.1:{free_port()}"
    with running_server(repository, "--websocket", place) as endpoint:
        yield endpoint, f"ws://{place}/"


def test_a_page_gets_pythons_numbers_bit_for_bit(page: Page, served: tuple[str, str]) -> None:
    endpoint, address = served
    windows = np.random.default_rng(5).normal(scale=0.5, size=(64, 12)).astype(np.float32)
    with taxel.connect(endpoint, transport="zenoh") as source:
        expected = source.predictor("xgb").predict(windows)
    # Doubles hold every float32, so that the page gets the same windows.
    told = page.evaluate(ASK, [address, windows.astype(float).tolist()])
    assert bytes(told) == expected.astype("<f4").tobytes()


def test_a_page_gets_typed_errors(page: Page, served: tuple[str, str]) -> None:
    is_ours, name, code, message = page.evaluate(FAIL, [served[1], "skn"])
    assert (is_ours, name, code) == (True, "TaxelError", "NOT_FOUND")
    assert message == "no model 'skn'; there is: xgb"
    nobody = f"ws://127.0.0.1:{free_port()}/"
    assert page.evaluate(FAIL, [nobody, "xgb"])[1:3] == ["ServerLost", "UNAVAILABLE"]


@pytest.mark.parametrize(("host", "told"), [(ANOTHER_SITE, "refused"), ("localhost", "opened")])
def test_a_page_of_another_site_gets_nothing(
    page: Page, site: str, served: tuple[str, str], host: str, told: str
) -> None:
    """The browser finds both names on this machine, so that the origin alone tells the pages apart."""
    browser = page.context.browser
    assert browser is not None
    visitor = browser.new_page()
    visitor.goto(site.replace("127.0.0.1", host))
    answer = visitor.evaluate(
        """(address) => new Promise((resolve) => {
          const socket = new WebSocket(address);
          socket.onopen = () => resolve("opened");
          socket.onclose = () => resolve("refused");
        })""",
        served[1],
    )
    visitor.close()
    assert answer == told


def test_the_readme_s_page_prints_what_it_shows(page: Page, served: tuple[str, str]) -> None:
    readme = (CLIENT / "README.md").read_text()
    _, example = re.findall(r"```ts\n(.*?)```", readme, re.DOTALL)
    shown = re.findall(r"```output\n(.*?)\n```", readme, re.DOTALL)[0]
    example = example.replace('"taxel"', '"/src/browser.js"').replace("ws://127.0.0.1:7449/", served[1])
    with page.expect_console_message() as printed:
        page.add_script_tag(content=example, type="module")
    assert printed.value.text == shown
