"""Tables of one `bench run`: Taxel beside its best peer and the published way, then every engine."""

from collections.abc import Sequence
from typing import Any, Final

from taxel_bench.engines import PUBLISHED, TAXEL
from taxel_bench.figures import markdown_table, short
from taxel_bench.run.comparing import fastest

Result = dict[str, Any]

_COLD: Final = "median_ms"
_WARM: Final = "warm_median_ms"


def run_tables(run: dict[str, Any]) -> list[str]:
    """Lines of Markdown for what `bench run --json` printed."""
    results = run["results"]
    batches = list(dict.fromkeys(result["batch"] for result in results))
    groups = [[result for result in results if result["batch"] == batch] for batch in batches]
    lines = [
        "In turn, so that each engine finds caches that the others have used; medians:",
        "",
        *markdown_table(_head(_COLD), [_leading_row(group, _COLD) for group in groups]),
        "",
        "Warm, each engine back to back; medians:",
        "",
        *markdown_table(_head(_WARM), [_leading_row(group, _WARM) for group in groups]),
    ]
    if any(result["engine"] not in (TAXEL, PUBLISHED) for result in results):
        lines += ["", "Every engine, ms in turn / warm; in italics those that round the weights:", ""]
        lines += _every_engine(groups)
        lines += ["", *_faster_than_taxel(groups)]
    lines += _left_out(groups, run.get("skipped", []))
    return lines


def _head(figure: str) -> list[str]:
    beside = ["`predict`"] if figure == _WARM else ["p99", "verdict"]
    published = ("published way, ms", "published way / Taxel")
    return ["rows", "best peer", "its ms", "Taxel, ms", "best peer / Taxel", *published, *beside]


def _leading_row(group: Sequence[Result], figure: str) -> list[str]:
    engines = {result["engine"]: result for result in group}
    ours, published, best = engines[TAXEL], engines.get(PUBLISHED), fastest(group, figure)
    name, time, ratio = _beside(ours, best, figure)
    if figure == _WARM:
        last = [short(ours["predictor_warm_median_ms"])]
    else:
        last = [short(ours["p99_ms"]), _verdict([each for each in (ours, published, best) if each])]
    return [
        f"{ours['batch']:,}",
        *(name, time, short(ours[figure]), f"**{ratio}**"),
        *_beside(ours, published, figure)[1:],
        *last,
    ]


def _beside(ours: Result, other: Result | None, figure: str) -> list[str]:
    """An engine's name, its time, and how many times faster ours is."""
    if other is None:
        return ["", "", ""]
    return [_name(other), short(other[figure]), short(other[figure] / ours[figure])]


def _verdict(results: Sequence[Result]) -> str:
    return "VALID" if all(result["verdict"] == "VALID" for result in results) else "INVALID"


def _name(result: Result) -> str:
    name = str(result["engine"])
    return {PUBLISHED: "published way", TAXEL: "**Taxel**"}.get(name, name)


def _every_engine(groups: Sequence[Sequence[Result]]) -> list[str]:
    names = dict.fromkeys(result["engine"] for group in groups for result in group)
    rows = []
    for engine in names:
        found = [next((each for each in group if each["engine"] == engine), None) for group in groups]
        first = next(each for each in found if each is not None)
        name = f"*{_name(first)}*" if first.get("rounded") else _name(first)
        cells = ["" if each is None else f"{short(each[_COLD])} / {short(each[_WARM])}" for each in found]
        rows.append([name, *cells, _difference(found)])
    head = ["engine", *(f"{group[0]['batch']:,} rows" for group in groups), "largest difference, counts"]
    return markdown_table(head, rows)


def _difference(found: Sequence[Result | None]) -> str:
    """How far an engine's answers are from ours, over all batch sizes."""
    results = [each for each in found if each is not None]
    differences = [each["largest_difference"] for each in results]
    if results[0]["engine"] == TAXEL or any(difference is None for difference in differences):
        return ""
    largest = max(differences)
    return f"{largest:.2g}" if largest else "equal bits"


def _faster_than_taxel(groups: Sequence[Sequence[Result]]) -> list[str]:
    """A sentence for each batch size: which engines are faster than ours, by name."""
    lines = []
    for group in groups:
        (ours,) = (result for result in group if result["engine"] == TAXEL)
        faster = []
        for result in group:
            times = [ours[figure] / result[figure] for figure in (_COLD, _WARM)]
            if max(times) > 1:
                said = " and ".join(
                    f"{short(ratio)} times {'in turn' if place == 0 else 'warm'}"
                    for place, ratio in enumerate(times)
                    if ratio > 1
                )
                rounds = ", with rounded weights" if result.get("rounded") else ""
                faster.append(f"{_name(result)} ({said}{rounds})")
        told = ", ".join(faster) if faster else "none"
        lines.append(f"- Faster than Taxel at {ours['batch']:,} rows: {told}.")
    return lines


def _left_out(groups: Sequence[Sequence[Result]], skipped: Sequence[dict[str, str]]) -> list[str]:
    lines = [f"- Skipped: {each['peer']}: {each['reason']}." for each in skipped]
    for result in (result for group in groups for result in group):
        for name, milliseconds in result.get("too_slow", {}).items():
            took = f"its call takes {short(milliseconds)} ms"
            lines.append(f"- Left out at {result['batch']:,} rows: {name}, as {took}.")
    return lines
