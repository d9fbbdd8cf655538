"""What `bench table` writes: the table as Markdown and JSON, and two plots."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from taxel_bench.figures import markdown_table, short
from taxel_bench.table.plots import draw_latency_against_batch, draw_time_against_parameters
from taxel_bench.verdict import verdict_of

TABLE: Final = "table.json"

Result = dict[str, Any]

_HEAD: Final = (
    *("model", "inputs", "parameters published", "here", "ms published", "published way here", "Taxel"),
    *("ratio", "Taxel warm", "warm ratio", "MFLOP published", "here", "Taxel", "verdict"),
)
_BATCH_HEAD: Final = (
    *("model", "batch", "published way here, ms", "Taxel, ms", "ratio", "Taxel warm, ms", "warm ratio"),
    "verdict",
)


def write_files(folder: Path, machine: dict[str, Any], results: Sequence[Result]) -> None:
    """Write all into an existing folder."""
    text = json.dumps({"machine": machine, "results": results}, indent=1, allow_nan=False)
    (folder / TABLE).write_text(text + "\n", encoding="utf-8")
    (folder / "table.md").write_text(markdown(machine, results), encoding="utf-8")
    draw_time_against_parameters(results, folder / "time_against_parameters.png")
    draw_latency_against_batch(results, folder / "latency_against_batch.png")


def markdown(machine: dict[str, Any], results: Sequence[Result]) -> str:
    """The table for single windows, the one over batch sizes, and what to know of both."""
    pairs = list(_pairs(results))
    single = [_cells(*pair) for pair in pairs if pair[0]["batch"] == 1]
    first = results[0]["inputs"]
    batches = [_batch_cells(*pair) for pair in pairs if pair[0]["inputs"] == first]
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    lines = [
        "# Inference, published and here",
        "",
        "One window, one thread, medians in ms, all 21 channels. The published way and Taxel's runtime",
        "were called in turn, so that each finds cold caches; *warm* calls follow each other.",
        "",
        *markdown_table(_HEAD, single),
        "",
        "- *ms published*: the mean over 100 windows on another processor. For `xgb` the published script",
        "  printed the time of one channel; here stands 21 times that.",
        "- *: the paper's inference table contradicts its hyperparameter table, which the model here",
        "  follows: the published figures are of a network of another size.",
        "- *MFLOP*: multiply-adds count as 2 (`taxel_bench.operations.rule`), of the published",
        "  architecture and of the graph that Taxel evaluates. For `xgb`, which was published without:",
        "  comparisons on the paths and additions.",
        "- Models have random weights at the published size. Both engines gave equal counts before timing.",
        "- *INVALID*: `table.json` says why.",
        "",
        f"## Latency against batch size, input combination {first}",
        "",
        *markdown_table(_BATCH_HEAD, batches),
        "",
        "## Machine",
        "",
        f"{machine['cpu']}, {machine['cores']} cores, {', '.join(machine['flags'])}; "
        f"load {machine['load']:g} at the start.",
        f"{machine['system']}, Python {machine['python']}; {versions}.",
    ]
    return "\n".join(lines) + "\n"


def _pairs(results: Sequence[Result]) -> Iterator[tuple[Result, Result]]:
    """The published way's result and ours, for each thing measured."""
    ours = {
        (each["model"], each["inputs"], each["batch"]): each
        for each in results
        if each["engine"] == "taxel"
    }
    for result in results:
        if result["engine"] == "paper":
            yield result, ours[result["model"], result["inputs"], result["batch"]]


def _cells(paper: Result, taxel: Result) -> list[str]:
    published = paper["published"]
    mark = "" if published["consistent"] else "\\*"
    flops = published["flops"]
    return [
        paper["model"],
        str(paper["inputs"]),
        f"{published['parameters']:,}{mark}",
        f"{paper['parameters']:,}",
        f"{short(published['inference_ms_all_channels'])}{mark}",
        *_times(paper, taxel),
        "" if flops is None else f"{short(flops / 1e6)}{mark}",
        short(paper["flops"] / 1e6),
        short(taxel["flops"] / 1e6),
        verdict_of(paper, taxel),
    ]


def _batch_cells(paper: Result, taxel: Result) -> list[str]:
    return [paper["model"], str(paper["batch"]), *_times(paper, taxel), verdict_of(paper, taxel)]


def _times(paper: Result, taxel: Result) -> list[str]:
    return [
        short(paper["median_ms"]),
        short(taxel["median_ms"]),
        f"{short(taxel['ratio'])}x",
        short(taxel["warm_median_ms"]),
        f"{short(taxel['warm_ratio'])}x",
    ]
