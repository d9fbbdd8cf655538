"""`taxel export`: write a trained model as an artifact."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel.errors import SettingsError
from taxel.manifest import Manifest
from taxel_exporters.card import rounding
from taxel_exporters.weights import Weights


class Origin(StrEnum):
    """The kinds of sources."""

    TRAINED = "trained"
    GAZEBO_PLUGIN = "gazebo-plugin"


@needs("train", *SERVING, "scipy", "threadpoolctl")
def export(
    source: Annotated[
        Path, typer.Argument(help="The folder that `taxel train` wrote, or the plugin's model.yaml.")
    ],
    repository: Annotated[Path, typer.Option("--repository", metavar="REPO", help="Where to add it.")],
    origin: Annotated[Origin, typer.Option("--from", help="Who trained it.")] = Origin.TRAINED,
    name: Annotated[str | None, typer.Option(help="Name to serve it under; the family's if none.")] = None,
    version: Annotated[str | None, typer.Option(help="Version; the next free one if none.")] = None,
    model_format: Annotated[
        str | None, typer.Option("--format", help="`xgboost` or `onnx`; the family's default if none.")
    ] = None,
    weights: Annotated[
        Weights, typer.Option(help="int8 is refused if the error rises by more than 1 %.")
    ] = Weights.FLOAT32,
    description: Annotated[str | None, typer.Option(help="One sentence for its card.")] = None,
    as_json: Json = False,
) -> None:
    """Export a trained model to a repository, and check it against the trained model."""
    with shown("exporting and checking parity") as tell:
        if origin is Origin.TRAINED:
            from taxel_exporters.export import export as run

            manifest = run(
                source,
                repository,
                name=name,
                version=version,
                model_format=model_format,
                weights=weights,
                description=description,
                progress=lambda what: tell(f"what the model gets wrong anyway: {what}"),
            )
        elif weights is not Weights.FLOAT32:
            raise SettingsError(
                f"--weights {weights}: for trained models only, which have held-out windows"
            )
        else:
            manifest = _import(source, repository, name, version, model_format, description)
    if as_json:
        print_json(manifest.model_dump(mode="json"))
        return
    place = repository / manifest.name / manifest.version
    OUT.print(f"Wrote {place}: {manifest.parameters} parameters, {manifest.model_file.size / 1e6:,.2f} MB.")
    if manifest.parity:
        kind = "held-out" if manifest.training else "random"
        OUT.print(
            f"Parity on {manifest.parity.windows} {kind} windows: largest difference "
            f"{manifest.parity.largest_difference:g} counts (allowed {manifest.parity.tolerance:g}).",
            soft_wrap=True,
        )
    if manifest.rounded_weights:
        OUT.print(rounding(manifest, manifest.rounded_weights), soft_wrap=True)
    if manifest.training and manifest.held_out_residual is None:
        OUT.print(
            "Its training held out less than 20 s and kept fewer than 8 contacts in all, so that what it "
            "gets wrong anyway is not known: taxel loop may name that. Train it on more contacts, or with "
            "a larger --test or --validation.",
            soft_wrap=True,
        )
    OUT.print(f"Next: taxel serve --repository {repository}", soft_wrap=True)


def _import(
    source: Path,
    repository: Path,
    name: str | None,
    version: str | None,
    model_format: str | None,
    description: str | None,
) -> Manifest:
    from taxel_exporters.gazebo.importer import import_network

    if model_format not in (None, "onnx"):
        raise SettingsError(f"--format {model_format!r}: a network of the Gazebo plugin is written as onnx")
    if name is None:
        raise SettingsError("--from gazebo-plugin: expected --name NAME, to serve it under")
    return import_network(source, repository, name=name, version=version, description=description)
