"""`bench report`: a page's tables from JSON, who is faster by name, and our own page up to date."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from taxel_bench.commands import app
from taxel_bench.report.page import rewritten
from taxel_bench.run.comparing import compare_engines

RESULTS = Path(__file__).resolve().parents[3] / "docs" / "results"
PAGES = [RESULTS / "benchmark.md", RESULTS / "benchmark_avx512.md"]


def result(engine: str, batch: int, median: float, warm: float, **more: Any) -> dict[str, Any]:
    return {
        "engine": engine,
        "batch": batch,
        "median_ms": median,
        "p99_ms": 2 * median,
        "cpu_median_ms": median,
        "warm_median_ms": warm,
        "verdict": "VALID",
        "warm_verdict": "INVALID" if engine == "openvino" else "VALID",
        "rounded": False,
        "largest_difference": 0.001,
        **more,
    }


def run_with_peers() -> dict[str, Any]:
    results: list[dict[str, Any]] = []
    for batch in (1, 1024):
        group = [
            result("paper", batch, 8.0 * batch, 6.0 * batch, largest_difference=0.0),
            result("onnxruntime", batch, 4.0 * batch, 1.5 * batch),
            result("openvino", batch, 5.0, 5.0),
            result("torch-compiled", batch, 0.3, 0.3, largest_difference=None),
            result("numpy", batch, batch / 1.004, 2.0 * batch),
            result("onnxruntime-int8", batch, 0.5 * batch, 3.0 * batch, rounded=True),
            result("taxel", batch, 1.0 * batch, 1.0 * batch, predictor_warm_median_ms=1.0),
        ]
        compare_engines(group)
        results += group
    results[-1] |= {
        "too_slow": {"treelite": 4321.0},
        "too_slow_limit_ms": 375.0,
        "left_out": {"daal": "no"},
    }
    return {"machine": {}, "results": results, "skipped": [{"peer": "torch-compiled", "reason": "no g++"}]}


def report(page: Path, code: int = 0) -> Result:
    done = CliRunner().invoke(app, ["report", str(page)])
    assert done.exit_code == code, done.output
    return done


def test_the_best_peer_leads_and_who_is_faster_is_told(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(run_with_peers()))
    page = tmp_path / "page.md"
    page.write_text("# Before\n\n<!-- bench report run.json -->\nold\n<!-- end -->\n\nAfter.\n")
    assert "1 parts written from JSON; the page is changed" in report(page).stdout
    text = page.read_text()
    assert text.startswith("# Before\n")
    assert text.endswith("\nAfter.\n")
    assert "old" not in text
    assert "| 1 | numpy | 0.996 | 1.00 | **0.996** | 8.00 | 8.00 | 2.00 | VALID |" in text
    assert "| 1 | onnxruntime | 1.50 | 1.00 | **1.50** | 6.00 | 6.00 | 1.00 | VALID |" in text
    assert "| 1,024 | openvino | 5.00 | 1,024 | **0.00488** | 8,192 | 8.00 | 2,048 | VALID |" in text
    assert "| 1,024 | openvino | 5.00 | 1,024 | **0.00488** | 6,144 | 6.00 | 1.00 | INVALID |" in text
    assert (
        "- Faster than Taxel at 1 row: torch-compiled (3.33 times in turn and 3.33 times warm), "
        "onnxruntime-int8 (2.00 times in turn, with rounded weights)." in text
    )
    assert "openvino (205 times in turn and 205 times warm), " in text
    assert "| published way | 8.00 / 6.00 | 8,192 / 6,144 | equal bits |" in text
    assert "| *onnxruntime-int8* |" in text
    assert "- Skipped: torch-compiled: no g++." in text
    took = "its call takes 4,321 ms, and 375 are allowed"
    assert f"- Left out at 1,024 rows: treelite: {took}." in text
    assert "- Left out at 1,024 rows: daal: no." in text
    assert "the page is as it was" in report(page).stdout


@pytest.mark.skipif(not RESULTS.is_dir(), reason="a source archive leaves the results out")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.stem))
def test_our_own_pages_hold_what_their_files_say(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    new, parts = rewritten(text, page.parent)
    assert parts == text.count("<!-- bench report ") > 0
    assert new == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nothing", "expected parts between"),
        ("<!-- bench report a.json -->\nnever ends", "expected parts between"),
        ("<!-- bench report missing.json -->\n<!-- end -->", "missing.json"),
        ("<!-- bench report page.md -->\n<!-- end -->", "no JSON"),
        ("<!-- bench report other.json -->\n<!-- end -->", "bench run --json"),
    ],
)
def test_a_page_that_cannot_be_written_is_left_alone(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "other.json").write_text("{}")
    page = tmp_path / "page.md"
    page.write_text(text)
    assert message in report(page, code=2).output.replace("\n", "")
    assert page.read_text() == text
