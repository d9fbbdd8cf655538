"""A study as files: `study.json`, `results.md`, LaTeX tables and pictures."""

import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from taxel import __version__
from taxel.atomic import whole_file, write_json, write_text
from taxel_models.study.cell import CellResult
from taxel_models.study.run import Study
from taxel_models.study.study_plots import (
    draw_channels,
    draw_combination_bars,
    draw_combination_boxes,
    draw_losses,
    draw_temperature,
)
from taxel_models.study.study_settings import Protocol
from taxel_models.study.study_tables import Table, leak_table, models_table, results_table, windows_table
from taxel_models.study.summary import Summary
from taxel_models.study.summary import leak as leak_of
from taxel_models.study.temperature import Temperature, temperature_table
from taxel_models.templates import render

FIGURES: Final = "study.json"
RESULTS: Final = "results.md"

_TEMPLATE: Final = Path(__file__).parent / "templates" / "results.md.j2"

_LIBRARIES: Final = ("numpy", "scipy", "statsmodels", "torch")


def describe(study: Study, cells: Sequence[CellResult]) -> dict[str, Any]:
    """Everything that is reported, for JSON; docs/study_json.md lists the fields."""
    summaries = _summaries(study, cells)
    settings = study.settings
    return {
        "schema_version": 1,
        "taxel_version": __version__,
        "libraries": {name: version(name) for name in _LIBRARIES},
        "data": [source.model_dump(mode="json") for source in study.sources],
        "published_data": study.published_data,
        "scale": {
            "reduced": bool(settings.rows is not None or settings.overrides),
            "rows": study.rows,
            "rows_used": study.rows_used,
            "overrides": {model: dict(values) for model, values in settings.overrides.items()},
        },
        "plan": {
            "models": list(settings.models),
            "combinations": list(settings.combinations),
            "folds": settings.folds,
            "unit": study.grouping,
            "seed": settings.seed,
            "temperature": settings.temperature,
            "hyperparameters": {
                model: {
                    str(number): settings.hyperparameters[model, number] for number in settings.combinations
                }
                for model in settings.models
            },
        },
        "protocols": {
            protocol: {**summary.describe(), "temperature": _temperature(summary)}
            for protocol, summary in summaries.items()
        },
        "leak": _leak(summaries),
    }


def write_report(study: Study, cells: Sequence[CellResult], folder: Path) -> None:
    """Write all files into the study's folder; each replaces an earlier one whole."""
    summaries = _summaries(study, cells)
    write_json(folder / FIGURES, describe(study, cells))
    sections: list[dict[str, Any]] = []
    for protocol, summary in summaries.items():
        tables = _tables(study, summary)
        pictures = _draw(summary, folder)
        held_out = study.partitions[protocol].held_out
        sections.append(
            {"protocol": protocol, "held_out": held_out, "tables": tables, "pictures": pictures}
        )
        for table in tables:
            write_text(folder / f"{table.name}.tex", table.latex())
    leaks = _leak(summaries)
    leak = leak_table(leaks) if leaks else None
    if leak is not None:
        write_text(folder / f"{leak.name}.tex", leak.latex())
    write_text(
        folder / RESULTS, render(_TEMPLATE, scale=scale_statement(study), sections=sections, leak=leak)
    )


def scale_statement(study: Study) -> str:
    """The data and settings of the study, and where it is smaller than the paper's, as a Markdown list."""
    settings = study.settings
    data = "; ".join(
        f"{source.name} ({source.format}, {source.rows:,} rows, sha256 {source.sha256[:12]}…)"
        for source in study.sources
    )
    replaced = [
        f"`{model}.{name}={json.dumps(value)}`"
        for model, values in settings.overrides.items()
        for name, value in values.items()
    ]
    lines = [
        f"data: {data}" + (", the data set of the paper" if study.published_data else ""),
        f"rows: {study.rows_used:,} of {study.rows:,} ticks"
        + (", **a reduced scale**" if study.rows_used < study.rows else ", all"),
        f"folds: {settings.folds}, seed {settings.seed}",
        "hyperparameters: as published"
        + (f" except {', '.join(replaced)}: **a reduced scale**" if replaced else ""),
    ]
    return "\n".join(f"- {line}" for line in lines)


def _summaries(study: Study, cells: Sequence[CellResult]) -> dict[Protocol, Summary]:
    return {protocol: Summary(protocol, cells) for protocol in study.settings.protocols}


def _temperature(summary: Summary) -> dict[str, Any] | None:
    found = Temperature.of(summary)
    return None if found is None else found.describe()


def _leak(summaries: dict[Protocol, Summary]) -> list[dict[str, Any]]:
    if "strict" not in summaries or "paper" not in summaries:
        return []
    return leak_of(summaries["strict"], summaries["paper"])


def _tables(study: Study, summary: Summary) -> list[Table]:
    found = [results_table(summary, published=study.published_data)]
    if summary.window_tests:
        found.append(windows_table(summary, published=study.published_data))
    if summary.model_tests:
        found.append(models_table(summary, published=study.published_data))
    temperature = Temperature.of(summary)
    if temperature is not None:
        found.append(temperature_table(temperature, published=study.published_data))
    return found


def _draw(summary: Summary, folder: Path) -> dict[str, str]:
    """Draw every picture; their names with captions."""
    captions = {}
    for name, caption, draw in _pictures(summary):
        with whole_file(folder / name) as temporary:
            draw(temporary)
        captions[name] = caption
    return captions


def _pictures(summary: Summary) -> Iterator[tuple[str, str, Callable[[Path], None]]]:
    """Name, caption and what draws it."""
    protocol = summary.protocol
    measure = "Normalised MAE of input combinations"
    yield f"bars-{protocol}.png", f"{measure}, mean and deviation", partial(draw_combination_bars, summary)
    yield f"boxes-{protocol}.png", f"{measure}, folds", partial(draw_combination_boxes, summary)
    for number in summary.combinations:
        caption = f"Normalised MAE of every channel, input combination {number}"
        yield f"channels-{protocol}-{number}.png", caption, partial(draw_channels, summary, number)
    for model in summary.models:
        yield f"losses-{protocol}-{model}.png", f"Losses of {model}", partial(draw_losses, summary, model)
    found = Temperature.of(summary)
    if found is not None:
        caption = "Normalised MAE over the given temperature of Network B"
        yield f"temperature-{protocol}.png", caption, partial(draw_temperature, found)
