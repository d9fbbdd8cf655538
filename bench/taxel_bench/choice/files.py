"""What `bench choice` writes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from taxel.atomic import whole_folder
from taxel_bench.choice.measurement import ComparedModel

FIGURES: Final = "choice.json"


def write_files(
    folder: Path, figures: Mapping[str, Any], compared: Sequence[ComparedModel], *, overwrite: bool
) -> None:
    """Write choice.json, choice.md and choice.png; the folder appears whole or not at all."""
    with whole_folder(folder, replacing=FIGURES, overwrite=overwrite) as place:
        (place / FIGURES).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        (place / "choice.md").write_text(markdown(compared), encoding="utf-8")
        _draw(compared, place / "choice.png")


def markdown(compared: Sequence[ComparedModel]) -> str:
    """One row for each model, the fastest answers first."""
    lines = [
        "| model | inputs | delay | warm-up | norm. MAE | one window | parameters |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| `{model.model}` | {model.combination} | {model.delay_ms:g} ms | {model.warm_up_ms:g} ms "
        f"| {model.norm_mae:.3f} | {model.median_us:.0f} µs "
        f"| {model.parameters:,} |"
        for model in sorted(compared, key=lambda model: (model.delay_ms, model.norm_mae))
    ]
    return "\n".join(lines) + "\n"


def _draw(compared: Sequence[ComparedModel], path: Path) -> None:
    """Error against the latency of a window; colours tell the delay."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    delays = sorted({model.delay_ms for model in compared})
    for number, delay in enumerate(delays):
        models = [model for model in compared if model.delay_ms == delay]
        label = "causal: no delay" if delay == 0 else f"answers {delay:g} ms late"
        axes.plot(
            [model.median_us for model in models],
            [model.norm_mae for model in models],
            "os^Dv"[number % 5],
            color=f"C{number}",
            markersize=9,
            label=label,
        )
        for model in models:
            axes.annotate(
                model.model,
                (model.median_us, model.norm_mae),
                textcoords="offset points",
                xytext=(8, 4),
                fontsize=8,
            )
    axes.set_xscale("log")
    axes.margins(x=0.35, y=0.15)
    axes.set_xlabel("latency of one window in process, median, µs")
    axes.set_ylabel("normalised MAE")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(path, dpi=120)
    plt.close(figure)
