"""`taxel loop`: find what a model lacks in recordings, and export it as a new version with that added."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from taxel.atomic import check_folder_place
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel.errors import SettingsError
from taxel_models.loop.inference.constants import DECLARED

if TYPE_CHECKING:
    from taxel_models.loop.pipeline import LoopResult

_CHECKED_WINDOWS: Final = 2048
"""The most windows that an exported correction is checked on."""


@needs("loop", *SERVING, "jinja2", "matplotlib", "scipy", "threadpoolctl")
def loop(
    model: Annotated[
        str, typer.Option(metavar="NAME[/VERSION]", help="The model; newest version if none.")
    ],
    repository: Annotated[Path, typer.Option(help="Folder of artifacts that has the model.")],
    data: Annotated[
        list[Path],
        typer.Option(help="A recording of the real sensor; give it again for several, each a session."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the report.")],
    export: Annotated[
        bool, typer.Option("--export", help="Add the corrected model to the repository, as a new version.")
    ] = False,
    hold_out_by: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Hold out whole values of a column, as material.")
    ] = None,
    held_out: Annotated[float, typer.Option(min=0.1, max=0.6, help="Share to evaluate on.")] = 0.3,
    calibration: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=60.0,
            help="Seconds at the start of each segment that count as a calibration of a user's own sensor; "
            "0: no calibration.",
        ),
    ] = 0.0,
    temperature: Annotated[
        str,
        typer.Option(
            help="What a model gets for tdc: measured, or its mean. With mean, the loop does not look for "
            "an effect of tdc either."
        ),
    ] = "measured",
    least_share: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="The least share of the error that an effect must take away to be named, on folds of the "
            "part that is fitted to; one channel, a delay or a fault may do with less.",
        ),
    ] = DECLARED.least_share,
    exclude: Annotated[
        list[str] | None, typer.Option(help="An effect not to look for; give it again for several.")
    ] = None,
    no_reference: Annotated[
        bool,
        typer.Option(
            "--no-reference",
            help="Name also what the model gets wrong anyway, on what its training held out.",
        ),
    ] = False,
    residual_model: Annotated[
        bool,
        typer.Option(
            "--residual-model",
            help="Also fit a model of what no effect explains, from what is known while serving. It has no "
            "name and says nothing of causes.",
        ),
    ] = False,
    stability: Annotated[
        int,
        typer.Option(
            min=0,
            max=1000,
            metavar="N",
            help="Name effects anew on N random halves of the blocks, and count how often each is named; "
            "0: do not.",
        ),
    ] = 2,
    seed: Annotated[int, typer.Option(help="Seed of the split and of all random draws.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a report at OUTPUT.")] = False,
    as_json: Json = False,
) -> None:
    """Compare a model with recordings, name the effects that it lacks, and say what adding them gains.

    Writes report.json, report.md, report.html and plots; `--json` prints report.json.
    """
    import taxel
    from taxel_models.loop.effects.registry import effect_named
    from taxel_models.loop.next_recording.proposals import propose
    from taxel_models.loop.pipeline import LoopSettings, run_loop
    from taxel_models.loop.report.report import REPORT, write_report
    from taxel_models.loop.report.table import findings_table
    from taxel_models.recordings import read_recording

    check_folder_place(output, replacing=REPORT, overwrite=overwrite)
    if temperature not in ("measured", "mean"):
        raise SettingsError(f"--temperature {temperature}: expected measured or mean")
    for effect in exclude or ():
        effect_named(effect)
    settings = LoopSettings(
        seed=seed,
        held_out=held_out,
        hold_out_by=hold_out_by,
        withheld=() if temperature == "measured" else ("tdc", "tac"),
        calibration_s=calibration,
        least_share=least_share,
        exclude=tuple(exclude or ()),
        reference=not no_reference,
        residual_model=residual_model,
        stability=stability,
    )
    name, _, version = model.partition("/")
    with taxel.load(repository) as source, shown("reading") as tell:
        predictor = source.predictor(name, version or None)
        trained = predictor.manifest.trained_contacts
        recordings = [read_recording(path, trained=trained) for path in data]
        result = run_loop(
            predictor,
            recordings,
            settings,
            lambda doing: tell(f"looking at {doing}"),
        )
        result = propose(result, progress=lambda doing: tell(f"simulating {doing}"))
    try:
        if export and result.new.effects and not result.findings.raises_the_error:
            with shown("exporting the corrected model and checking parity"):
                result = _exported(result, repository)
    finally:
        # What was found is not lost with an export that fails.
        with shown("writing the report"):
            write_report(output, result)
    if as_json:
        print_json(result.findings.model_dump(mode="json"))
    else:
        OUT.print(findings_table(result.findings))
        OUT.print(f"Wrote {output}: report.md, report.html, report.json.", soft_wrap=True)
        if export:
            exported = result.findings.exported or f"nothing: {_why_not(result)}"
            OUT.print(f"Exported {exported}.", soft_wrap=True)


def _why_not(result: "LoopResult") -> str:
    if not result.new.effects:
        return "nothing was found that a model can have"
    return "on blocks that nothing was fitted to, the corrected model is off by more than before"


def _exported(result: "LoopResult", repository: Path) -> "LoopResult":
    from taxel_exporters.corrected import export_corrected

    manifest = result.observations.manifest
    names = ", ".join(effect.name for effect in result.new.effects)
    written = export_corrected(
        repository,
        manifest.name,
        manifest.version,
        result.new.effects,
        result.new.extras,
        windows=result.served_windows(_CHECKED_WINDOWS),
        description=f"{manifest.description} Corrected for: {names}.",
    )
    return result.exported(written.label)
