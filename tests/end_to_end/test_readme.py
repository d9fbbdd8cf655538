"""The README's own words, run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from taxel_bench.server_process import running_server
from taxel_models.shipped import shipped_repository

ROOT = Path(__file__).resolve().parents[2]


def test_the_readme_example_runs(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(example.strip().splitlines()) <= 12
    with running_server(shipped_repository()) as endpoint:
        script = tmp_path / "example.py"
        script.write_text(example.replace("tcp/127.0.0.1:7447", endpoint))
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "'pac0'" in done.stdout
    assert "'e19'" in done.stdout


def test_the_examples_of_the_page_on_simulators_run(tmp_path: Path) -> None:
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "simulators.md").read_text(), re.DOTALL)
    script = tmp_path / "example.py"
    script.write_text("\n".join([*examples, "print(channels.shape)"]))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("(64, 21)\n")


def test_every_link_of_the_documents_leads_somewhere() -> None:
    if not (ROOT / "docs" / "results").is_dir():
        pytest.skip("a source archive leaves the results out")
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("*/README.md")]
    for document in documents:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", document.read_text()):
            assert (document.parent / target).exists(), f"{document}: {target}"
