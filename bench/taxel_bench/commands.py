"""The `bench` command."""

from typing import Annotated

import typer

from taxel.commands.frame import ERR, OUT, Json, failing_clearly, new_app, print_json
from taxel.errors import SettingsError

app = new_app("Measure Taxel's models and server.")


@app.callback()
def frame() -> None:
    """Measure Taxel's models and server."""


@app.command("run")
@failing_clearly
def run(
    model: Annotated[str, typer.Option(help="A shipped model's name, or the folder of an artifact.")],
    batch: Annotated[str, typer.Option(help="Windows a call, one or several sizes: 1,8,64.")] = "1",
    repetitions: Annotated[int, typer.Option(min=100, help="Timed calls at each size.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the random windows.")] = 0,
    as_json: Json = False,
) -> None:
    """Time a model in this process: median and tails after a warm-up."""
    from taxel_bench.machine import describe_machine
    from taxel_bench.run import results_table
    from taxel_bench.run import run as measure
    from taxel_bench.subjects import artifact_subject

    batches = parse_batches(batch)
    with ERR.status("measuring"), artifact_subject(model) as subject:
        results = measure(subject, batches=batches, repetitions=repetitions, seed=seed)
    machine = describe_machine()
    if as_json:
        print_json({"machine": machine, "results": results})
        return
    OUT.print(results_table(results))
    OUT.print(f"{repetitions} calls each on {machine['cpu']}, one thread.", soft_wrap=True)


def parse_batches(text: str) -> list[int]:
    """Batch sizes from `1,8,64`.

    Raises:
        SettingsError: one is not a positive whole number.
    """
    try:
        sizes = [int(part) for part in text.split(",")]
    except ValueError:
        sizes = [0]
    if min(sizes) < 1:
        raise SettingsError(f"--batch {text}: expected whole numbers above 0, such as 1,8,64")
    return sizes


def main() -> None:
    """Entry point of the `bench` command."""
    app()
