"""The command `bench forms`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.dependencies import SERVING
from taxel_bench.options import Seed, parse_batches, parse_names


@needs("bench", *SERVING, "psutil")
def forms(
    forest: Annotated[
        str, typer.Option(help="even and skewed, of the paper's size, and shipped; one or several.")
    ] = "even,skewed,shipped",
    model: Annotated[
        list[Path] | None, typer.Option(help="The folder of an artifact, or an XGBoost JSON file, too.")
    ] = None,
    batch: Annotated[str, typer.Option(help="Windows a call: 1,8,64.")] = "1,8,64,1024",
    without: Annotated[
        str | None, typer.Option(help="What is switched off, one after the other; all if not given.")
    ] = None,
    repetitions: Annotated[int, typer.Option(min=2, help="Timed calls at each size.")] = 40,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Time forests with each evaluator, and each special case within one, switched off.

    All are evaluated in turn in one run: cold, after the caches were emptied, and warm. The cost of an
    absence is the growth of the processor's time, as the median over the rounds.
    """
    from taxel_bench.forms.absence import EVICTION_BYTES, NAMES, Absences
    from taxel_bench.forms.files import forest_files
    from taxel_bench.machine import describe_machine
    from taxel_bench.progress import progress_bar, shifted
    from taxel_server.runtimes.compiled.processor import instruction_set

    batches = parse_batches(batch)
    switches = NAMES if without is None else parse_names("--without", without, NAMES, "switch")
    results: list[dict[str, Any]] = []
    with forest_files(forest.split(","), model or [], seed) as files:
        total = len(files) * len(batches) * repetitions
        with progress_bar("loading", total) as bar:
            for name, path in files.items():
                measured = Absences(path, switches, bar.say)
                for rows in batches:
                    bar.say(f"{name}, {rows} rows")
                    watch = shifted(bar.reach, len(results) // (len(switches) + 1) * repetitions)
                    found = measured.measure(rows, repetitions, seed, watch)
                    results += [{"forest": name, **result} for result in found]
    if as_json:
        machine = describe_machine()
        print_json(
            {
                "machine": machine,
                "instruction_set": instruction_set(),
                "eviction_bytes": EVICTION_BYTES,
                "results": results,
            }
        )
        return
    OUT.print(_table(results, batches, instruction_set()))


def _table(results: list[dict[str, Any]], batches: list[int], instructions: str) -> Any:
    """One row for each forest and switch: what its absence costs at each batch size, cold / warm."""
    from rich.table import Table

    heads = (f"{rows} rows" if rows > 1 else "1 row" for rows in batches)
    table = Table("forest", "without", *heads, caption=f"cold / warm, with {instructions}")
    for name, without in dict.fromkeys((one["forest"], one["without"]) for one in results):
        cells = (_cell(one) for one in results if (one["forest"], one["without"]) == (name, without))
        table.add_row("" if without else name, without, *cells)
    return table


def _cell(result: dict[str, Any]) -> str:
    """The processor's milliseconds with all switches on, or their growth with one off."""
    if result["without"]:
        return f"{result['cold_cost']:+.0%} / {result['warm_cost']:+.0%}"
    return f"{result['cold_cpu_ms']:.3f} / {result['warm_cpu_ms']:.3f} ms"
