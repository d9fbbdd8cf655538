"""Follow docs/start.md, as a newcomer does: the wheel alone, in a new environment on the newest Python.

    python3 tests/matrix/newcomer.py [--python 3.13] [-o docs/results/newcomer.json]

Each part of the page is timed. Exit status: 0 where every part worked, 1 where one did not.
"""

import argparse
import json
import os
import platform
import re
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory
from urllib.request import urlopen

from environments import Environment, Failed, build_wheel, environment
from pythons import SUPPORTED, Python, find

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "start.md"
EXTRAS = "server,watch,trees"
"""What the page names, in the order of its parts; pip would not take long for each by itself."""

PATIENCE_S = 10.0
"""A program asks again for so long: a server that runs sees new files within seconds."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--python", choices=SUPPORTED, help="the newest of this machine, if not given")
    parser.add_argument("-o", "--output", type=Path, help="where the times go, as JSON")
    options = parser.parse_args()
    found = find((options.python,) if options.python else SUPPORTED)
    if not found:
        print(f"no Python {options.python or ' or '.join(SUPPORTED)} on this machine", file=sys.stderr)
        return 1
    python = list(found.values())[-1]
    try:
        parts = follow(python)
    except Failed as error:
        print(error, file=sys.stderr)
        return 1
    told = {
        "page": str(PAGE.relative_to(ROOT)),
        "python": python.version,
        "machine": {"processor": platform.machine(), "cores": os.cpu_count(), "load": os.getloadavg()[0]},
        "parts": [{"part": name, "seconds": round(seconds, 1)} for name, seconds in parts],
        "seconds": round(sum(seconds for _, seconds in parts), 1),
    }
    if options.output:
        options.output.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(told, indent=1))
    return 0


def follow(python: Python) -> list[tuple[str, float]]:
    """The page's parts, and how long each took, s.

    Raises:
        Failed: a command of the page failed, or printed something else than the page shows.
    """
    times: list[tuple[str, float]] = []
    with TemporaryDirectory(prefix="taxel-wheel-") as folder, environment(python) as here:
        wheel = build_wheel(python, ROOT, Path(folder).resolve())
        servers: list[Popen[str]] = []
        try:
            for part, blocks in parts_of(PAGE.read_text(encoding="utf-8")):
                print(f"{part} …", file=sys.stderr, flush=True)
                began = time.monotonic()
                printed = again = ""
                for language, text in blocks:
                    if language == "output":
                        ends = time.monotonic() + PATIENCE_S
                        while not shows(printed, text) and again and time.monotonic() < ends:
                            printed = here.python("-c", again).stdout
                        compare(part, printed, text)
                    elif language == "python":
                        again = text
                        printed = here.python("-c", text).stdout
                    elif language == "sh":
                        lines = text.splitlines()
                        again = ""
                        printed = "".join(carry_out(here, wheel, line, servers) for line in lines)
                times.append((part, time.monotonic() - began))
        finally:
            end(servers)
    return times


def parts_of(text: str) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The page's headings with fenced blocks, and the blocks: language and text."""
    for part in text.split("\n## ")[1:]:
        blocks = re.findall(r"```(\w+)\n(.*?)```", part, re.DOTALL)
        if blocks:
            yield part.partition("\n")[0], blocks


def carry_out(here: Environment, wheel: Path, line: str, servers: list[Popen[str]]) -> str:
    """What a line of the page prints. Servers run on, each until the next one."""
    words = shlex.split(line)
    if words[:2] == ["pip", "install"]:
        here.install(f"{wheel}[{EXTRAS}]")
        return here.run("taxel", "demo").stdout
    if words[:2] == ["taxel", "serve"]:
        end(servers)
        server = here.started(*words)
        servers.append(server)
        assert server.stdout is not None
        while "listening on" not in (said := server.stdout.readline()):
            if not said:
                raise Failed(f"{line}: it ended with status {server.wait()}")
        return ""
    if words[:2] == ["taxel", "watch"]:
        watch = here.started(*words, "--no-open", "--json")
        assert watch.stdout is not None
        try:
            address = json.loads(watch.stdout.readline())["address"]
            with urlopen(address, timeout=10) as page:
                return str(page.read(100))
        finally:
            end([watch])
    # Whether a loop would fit depends on what else this machine does.
    return here.run(*words, check=words[:2] != ["taxel", "check"]).stdout


def end(running: list[Popen[str]]) -> None:
    """End processes, and forget them."""
    while running:
        process = running.pop()
        process.terminate()
        process.communicate()


def shows(printed: str, shown: str) -> bool:
    """Whether it printed that; `…` stands for anything, over any number of lines."""
    pattern = ".*".join(map(re.escape, shown.strip().split("…")))
    return re.search(pattern, printed.strip(), re.DOTALL) is not None


def compare(part: str, printed: str, shown: str) -> None:
    """Raise where it printed something else."""
    if not shows(printed, shown):
        raise Failed(f"{part}: the page shows\n{shown}\nand this was printed:\n{printed}")


if __name__ == "__main__":
    sys.exit(main())
