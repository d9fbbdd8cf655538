"""`make docs`: build the documentation site into `site/`."""

import subprocess
import sys
from pathlib import Path

from llms import write_llms
from reference import write_reference
from sources import gather

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """The exit status: 0 where the site was built, and no link leads nowhere."""
    pages = ROOT / "build" / "pages"
    gather(ROOT, pages)
    write_reference(pages / "docs" / "reference")
    built = subprocess.run([sys.executable, "-m", "zensical", "build", "--strict"], cwd=ROOT)
    if built.returncode == 0:
        write_llms(pages, ROOT / "site")
    opened = "Open site/index.html. Its search needs a server: python3 -m http.server -d site"
    print(f"The site is built. {opened}" if built.returncode == 0 else "The site is NOT built.")
    return built.returncode


if __name__ == "__main__":
    sys.exit(main())
