"""The command `bench run`."""

from enum import StrEnum
from typing import Annotated

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.dependencies import SERVING
from taxel.errors import SettingsError
from taxel_bench.options import Repetitions, Seconds, Seed, parse_batches


class Protocol(StrEnum):
    """How latencies are taken."""

    SERVING = "serving"
    PAPER = "paper"


class Size(StrEnum):
    """Which model of a name is measured."""

    SHIPPED = "shipped"
    PAPER = "paper"


class Trees(StrEnum):
    """How the trees of a forest from a seed grow."""

    EVEN = "even"
    SKEWED = "skewed"


@needs("bench", *SERVING, "matplotlib", "psutil", "sklearn", "torch", "xgboost")
def run(
    model: Annotated[
        str,
        typer.Option(help="xgb, ffnn, transformer, network-b, network-a, or the folder of an artifact."),
    ],
    inputs: Annotated[
        int | None,
        typer.Option(min=1, max=8, help="Input combination; other than the shipped model's: --size paper."),
    ] = None,
    batch: Annotated[str, typer.Option(help="Windows a call, one or several sizes: 1,8,64.")] = "1",
    protocol: Annotated[
        Protocol,
        typer.Option(help="serving: medians and tails. paper: mean of 100 single windows, as published."),
    ] = Protocol.SERVING,
    size: Annotated[
        Size | None,
        typer.Option(
            help="shipped: the small model that comes with Taxel. paper: random weights at the published "
            "size. If not given, shipped where it fits the other options."
        ),
    ] = None,
    trees: Annotated[
        Trees | None,
        typer.Option(
            help="Of xgb at the paper's size. even: as published. skewed: as many nodes in deep trees of "
            "some 1,100."
        ),
    ] = None,
    peers: Annotated[
        str | None,
        typer.Option(help="Other libraries beside: all, or names with commas between."),
    ] = None,
    install: Annotated[
        bool, typer.Option("--install", help="Install peers that are not, each into its own environment.")
    ] = False,
    repetitions: Repetitions = None,
    seconds: Seconds = 60.0,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Time a model in this process, in turn with the published way and other libraries.

    A corrected model is timed in turn with its base. `--json` prints `machine`, `results`, one for
    each batch size and engine, and `skipped`; bench/run.md names their fields.
    """
    from taxel_bench.machine import describe_machine
    from taxel_bench.peers.selection import NO_PEERS, parse_peer_choice
    from taxel_bench.progress import progress_bar
    from taxel_bench.run.protocols import Effort, run_paper, run_serving
    from taxel_bench.run.results import paper_table, remarks, serving_table
    from taxel_bench.subjects.subject import open_subject

    batches = parse_batches(batch)
    as_published = protocol is Protocol.PAPER
    if as_published and batches != [1]:
        raise SettingsError(f"--batch {batch}: the paper's protocol has single windows alone")
    if install and peers is None:
        raise SettingsError("--install: expected --peers, which says what to install")
    choice = NO_PEERS if peers is None else parse_peer_choice(peers, install=install)
    effort = Effort(repetitions, seconds, seed)
    with (
        progress_bar("loading", len(batches)) as bar,
        open_subject(
            model,
            combination=inputs,
            size=None if size is None else size.value,
            trees=None if trees is None else trees.value,
            seed=seed,
            peers=choice,
        ) as subject,
    ):
        machine = describe_machine()
        bar.say("measuring")
        if as_published:
            results = run_paper(subject, effort, bar.reach)
        else:
            results = run_serving(subject, batches, effort, bar.reach)
    if as_json:
        skipped = [{"peer": name, "reason": reason} for name, reason in subject.skipped.items()]
        print_json({"machine": machine, "results": results, "skipped": skipped})
        return
    OUT.print(paper_table(results) if as_published else serving_table(results))
    for line in remarks(results, subject.skipped, machine):
        OUT.print(line, soft_wrap=True, markup=False)
