"""`taxel twin`: write a simulated recording, with injected effects if asked for."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from taxel.atomic import check_file_place, write_json
from taxel.commands.cli import OUT, Json, print_json
from taxel.dependencies import require
from taxel.errors import SettingsError

if TYPE_CHECKING:
    from taxel_models.recordings import Recording
    from taxel_models.recovery.injection import Injection

_SUMMARY: Final = {
    "touched_share": "rows in contact: {:.1%}",
    "force_p99_n": "force, 99th percentile: {:.4g} N",
    "force_max_n": "force, maximum: {:.4g} N",
    "tdc_first": "tdc at the start: {:.0f} counts",
    "tdc_last": "tdc at the end: {:.0f} counts",
    "mean_predictor_norm_mae": "normalised MAE of the mean predictor: {:.4g}",
}
"""How each figure of a summary is printed."""

Rows = Annotated[int, typer.Option("--rows", min=1, help="Length: 100 rows are a second.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed and rows, same recording.")]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="CSV", help="The file to write.")]
Effects = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="NAME[:STRENGTH]",
        help="Inject an effect; repeat the option for several. The file does not name them. Strength 1, "
        "the default, changes channels by a tenth of their standard deviation, about a good model's error.",
    ),
]
Truth = Annotated[
    Path | None,
    typer.Option(metavar="JSON", help="Where to write what was injected; CSV.truth.json if not given."),
]
Into = Annotated[
    Path | None,
    typer.Option(metavar="RECORDING", help="Inject into this recording instead of a simulated one."),
]
Steps = Annotated[
    Path | None,
    typer.Option(
        "--protocol",
        metavar="JSON",
        help="Touch the finger as a recording protocol says, such as one of `taxel loop`. It says how "
        "long, too.",
    ),
]


def twin(
    output: Output,
    rows: Rows = 60_000,
    seed: Seed = 7,
    effect: Effects = None,
    truth: Truth = None,
    into: Into = None,
    protocol: Steps = None,
    as_json: Json = False,
) -> None:
    """Write a simulated recording of a BioTac 2P, in the CSV format of the published data set.

    With `--effect`, effects are injected into its channels (a turned frame in its recorded forces).
    The recording does not name them; a second file does.
    """
    from taxel_models.recordings import read_recording, write_ruppel
    from taxel_models.twin.summary import summarise

    if into is not None and not effect:
        raise SettingsError("--into: expected --effect, something to inject")
    if into is not None and protocol is not None:
        raise SettingsError("--into and --protocol: expected one of them")
    if truth is not None and not effect:
        raise SettingsError("--truth: expected --effect as well")
    if effect:
        require("--effect", "loop", "scipy")
    check_file_place(output)
    recording = read_recording(into) if into is not None else _simulated(rows, seed, protocol)
    injection = _injected(recording, effect, seed) if effect else None
    if injection is not None:
        recording = injection.recording
        place = truth or output.with_name(output.name + ".truth.json")
        write_json(place, {"seed": seed, "effects": injection.truth})
    write_ruppel(recording, output)
    summary = summarise(recording)
    if as_json:
        print_json({"output": str(output), "rows": len(recording), "seed": seed, **summary})
        return
    kind = "simulated" if into is None else f"from {into}"
    OUT.print(
        f"wrote {output}: {len(recording)} rows ({len(recording) / 100:g} s), seed {seed}, {kind}",
        soft_wrap=True,
    )
    for name, value in summary.items():
        OUT.print("  " + _SUMMARY[name].format(value))


def _simulated(rows: int, seed: int, protocol: Path | None) -> "Recording":
    from taxel_models.twin import perform, simulate
    from taxel_models.twin.protocol import read_protocol

    return simulate(rows, seed) if protocol is None else perform(read_protocol(protocol), seed)


def _injected(recording: "Recording", effects: list[str], seed: int) -> "Injection":
    from taxel_models.recovery.injection import Injection
    from taxel_models.recovery.injectors import inject

    injection = Injection.into(recording, seed)
    for text in effects:
        name, strength = _parse(text)
        inject(injection, name, strength)
    return injection


def _parse(text: str) -> tuple[str, float]:
    """A name, which may be `covariate:NAME`, and a strength."""
    name, _, last = text.rpartition(":")
    try:
        strength = float(last)
    except ValueError:
        return text, 1.0
    if not name or not 0 < strength < float("inf"):
        raise SettingsError(f"--effect {text}: expected NAME or NAME:STRENGTH, a strength above 0")
    return name, strength
