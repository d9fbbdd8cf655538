"""A study's tables, as Markdown and LaTeX."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from taxel_models.study.published import published_models, published_result, published_windows
from taxel_models.study.summary import MEAN_PREDICTOR, PairTest, Summary
from taxel_models.templates import render

_TEMPLATES: Final = Path(__file__).parent / "templates"

_FIGURES = (
    ("mae", "MAE"),
    ("norm_mae", "norm. MAE"),
    ("mae_electrodes", "MAE el."),
    ("norm_mae_electrodes", "norm. MAE el."),
    ("rmse", "RMSE"),
    ("norm_rmse", "norm. RMSE"),
    ("rmse_electrodes", "RMSE el."),
    ("norm_rmse_electrodes", "norm. RMSE el."),
)
_DECIMALS = 3


@dataclass(frozen=True)
class Table:
    """Text in columns; the first is left-aligned, the others right.

    Attributes:
        name: for file names and labels.
        caption: what it shows.
    """

    name: str
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """With its caption above."""
        return render(_TEMPLATES / "table.md.j2", table=self)

    def latex(self) -> str:
        """A `table*` environment that needs no package."""
        return render(_TEMPLATES / "table.tex.j2", table=self)


def results_table(summary: Summary, *, published: bool) -> Table:
    """Parameters and errors of every model and combination.

    Args:
        published: put the paper's figures below ours.
    """
    rows = []
    for entry in summary.entries.values():
        name = f"{entry.model} {entry.combination}"
        rows.append((name, _thousands(entry.parameters), *_means_and_stds(entry.figures())))
        known = published_result(entry.model, entry.combination) if published else None
        if known:
            rows.append(
                (f"{name}, published", f"{known['parameters_k']:.0f}", *_published_means_and_stds(known))
            )
    rows.append((MEAN_PREDICTOR, "", *_means_and_stds(summary.mean_predictor())))
    return Table(
        f"results-{summary.protocol}",
        f"Protocol {summary.protocol}: mean over folds, standard deviation in parentheses. Parameters in "
        "thousands, for trees their nodes; MAE and RMSE in counts, norm. in standard deviations; "
        "el.: over the 19 electrodes alone.",
        ("model, inputs", "parameters", *(label for _, label in _FIGURES)),
        tuple(rows),
    )


def windows_table(summary: Summary, *, published: bool) -> Table:
    """Input combinations against each other."""
    return _tests_table(
        f"windows-{summary.protocol}",
        f"Protocol {summary.protocol}: is the first input combination's normalised MAE lower?",
        "model",
        summary.window_tests,
        [published_windows(test.group, test.name) if published else None for test in summary.window_tests],
    )


def models_table(summary: Summary, *, published: bool) -> Table:
    """Models against each other."""
    return _tests_table(
        f"models-{summary.protocol}",
        f"Protocol {summary.protocol}: is the first model's normalised MAE lower?",
        "inputs",
        summary.model_tests,
        [
            published_models(int(test.group), test.name) if published else None
            for test in summary.model_tests
        ],
    )


def leak_table(leaks: Sequence[dict[str, Any]]) -> Table:
    """How much lower the paper's protocol makes the errors."""
    rows = [
        (
            f"{leak['model']} {leak['combination'] or ''}".rstrip(),
            *(f"{leak['mae'][which]:.3f}" for which in ("strict", "paper")),
            _percent(leak["mae"]["share"]),
            *(f"{leak['norm_mae'][which]:.3f}" for which in ("strict", "paper")),
            _percent(leak["norm_mae"]["share"]),
        )
        for leak in leaks
    ]
    return Table(
        "leak",
        "What the leak was worth: errors of the same data under both protocols, and the share of the "
        "strict error by which the paper's protocol is lower.",
        ("model, inputs", "MAE strict", "MAE paper", "lower by", "norm. strict", "norm. paper", "lower by"),
        tuple(rows),
    )


def _tests_table(
    name: str,
    question: str,
    group: str,
    tests: Sequence[PairTest],
    published: Sequence[dict[str, float] | None],
) -> Table:
    head: tuple[str, ...] = (
        f"{group}, comparison",
        "difference",
        "95 % interval",
        "t",
        "p",
        "p Holm",
        "effect",
    )
    if any(published):
        head += ("published difference", "published t", "published p")
    rows = []
    for test, known in zip(tests, published, strict=True):
        row = [f"{test.group}: {test.name}", *_outcome(test)]
        if any(published):
            row += _published_outcome(known)
        rows.append(tuple(row))
    return Table(
        name,
        f"{question} Corrected resampled paired t-test, one-sided; differences of normalised MAE in "
        f"percent points; Holm's correction is for the {len(tests)} comparisons of this table; effect: "
        "the difference in its standard deviations over folds.",
        head,
        tuple(rows),
    )


def _outcome(test: PairTest) -> list[str]:
    found = test.outcome
    return [
        f"{100 * found.difference:+.3f}",
        f"{100 * found.low:+.3f} to {100 * found.high:+.3f}",
        _or_empty(found.t),
        f"{found.p:.3f}",
        f"{found.p_holm:.3f}",
        _or_empty(found.effect),
    ]


def _published_outcome(known: dict[str, float] | None) -> list[str]:
    if known is None:
        return ["", "", ""]
    return [f"{known['diff_percent']:+.3f}", _or_empty(known.get("t")), f"{known['p']:.3f}"]


def _or_empty(value: float | None) -> str:
    return "" if value is None else f"{value:+.3f}"


def _percent(share: float) -> str:
    return f"{100 * share:+.1f} %"


def _thousands(parameters: float) -> str:
    return f"{parameters / 1000:.0f}" if parameters >= 10_000 else f"{parameters / 1000:.1f}"


def _means_and_stds(figures: dict[str, Any]) -> list[str]:
    return [
        f"{figures[key]['mean']:.{_DECIMALS}f} ({figures[key]['std']:.{_DECIMALS}f})" for key, _ in _FIGURES
    ]


def _published_means_and_stds(known: dict[str, Any]) -> list[str]:
    return [
        f"{known[key]:.{_DECIMALS}f} ({known['std'][key]:.{_DECIMALS}f})" if key in known else ""
        for key, _ in _FIGURES
    ]
