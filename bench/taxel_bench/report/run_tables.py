"""Tables of one `bench run`: Taxel beside its best peer and the published way, then every engine."""

from collections.abc import Sequence
from typing import Any, Final

from taxel_bench.engines import PUBLISHED, TAXEL
from taxel_bench.figures import markdown_table, short
from taxel_bench.run.comparing import fastest

Result = dict[str, Any]

_COLD: Final = "median_ms"
_WARM: Final = "warm_median_ms"
_FASTER: Final = 1.005
"""From where on a ratio is not printed as 1.00."""


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
    beside = ["`predict`, ms" if figure == _WARM else "Taxel p99, ms", "verdict"]
    published = ("published way, ms", "published way / Taxel")
    return ["rows", "best peer", "its ms", "Taxel, ms", "best peer / Taxel", *published, *beside]


def _leading_row(group: Sequence[Result], figure: str) -> list[str]:
    engines = {result["engine"]: result for result in group}
    ours, published, best = engines[TAXEL], engines.get(PUBLISHED), fastest(group, figure)
    name, time, ratio = _beside(ours, best, figure)
    compared = [each for each in (ours, published, best) if each]
    if figure == _WARM:
        last = [short(ours["predictor_warm_median_ms"]), _verdict(compared, "warm_verdict")]
    else:
        last = [short(ours["p99_ms"]), _verdict(compared, "verdict")]
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


def _verdict(results: Sequence[Result], key: str) -> str:
    """Of a row; nothing where a file of an older Taxel has none."""
    if not all(key in result for result in results):
        return ""
    return "VALID" if all(result[key] == "VALID" for result in results) else "INVALID"


def _rows(result: Result) -> str:
    batch = result["batch"]
    return "1 row" if batch == 1 else f"{batch:,} rows"


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
    head = ["engine", *(_rows(group[0]) for group in groups), "largest difference, counts"]
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
            if max(times) >= _FASTER:
                said = " and ".join(
                    f"{short(ratio)} times {'in turn' if place == 0 else 'warm'}"
                    for place, ratio in enumerate(times)
                    if ratio >= _FASTER
                )
                rounds = ", with rounded weights" if result.get("rounded") else ""
                faster.append(f"{_name(result)} ({said}{rounds})")
        told = ", ".join(faster) if faster else "none"
        lines.append(f"- Faster than Taxel at {_rows(ours)}: {told}.")
    return lines


def _left_out(groups: Sequence[Sequence[Result]], skipped: Sequence[dict[str, str]]) -> list[str]:
    lines = [f"- Skipped: {each['peer']}: {each['reason']}." for each in skipped]
    for result in (result for group in groups for result in group):
        told = list(result.get("left_out", {}).items())
        for name, milliseconds in result.get("too_slow", {}).items():
            limit = result.get("too_slow_limit_ms")
            allowed = "" if limit is None else f", and {short(limit)} are allowed"
            told.append((name, f"its call takes {short(milliseconds)} ms{allowed}"))
        lines += [f"- Left out at {_rows(result)}: {name}: {reason}." for name, reason in told]
    return lines
