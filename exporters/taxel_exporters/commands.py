"""`taxel export`: make a trained model servable."""

from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.frame import ERR, OUT, Json, print_json


def export(
    folder: Annotated[Path, typer.Argument(help="What `taxel train` wrote.")],
    repository: Annotated[Path, typer.Option("--repository", metavar="REPO", help="Where to add it.")],
    name: Annotated[str | None, typer.Option(help="Name to serve it under; the family's if none.")] = None,
    version: Annotated[str | None, typer.Option(help="Version; the next free one if none.")] = None,
    model_format: Annotated[
        str | None, typer.Option("--format", help="`xgboost` or `onnx`; the family's default if none.")
    ] = None,
    description: Annotated[str | None, typer.Option(help="One sentence for its card.")] = None,
    as_json: Json = False,
) -> None:
    """Export a trained model to a repository, checked against the trained one."""
    from taxel_exporters.export import export as run

    with ERR.status("exporting and checking parity"):
        manifest = run(
            folder,
            repository,
            name=name,
            version=version,
            model_format=model_format,
            description=description,
        )
    if as_json:
        print_json(manifest.model_dump(mode="json"))
        return
    place = repository / manifest.name / manifest.version
    OUT.print(f"Wrote {place}: {manifest.parameters} parameters, {manifest.model_file.size / 1e6:.1f} MB.")
    if manifest.parity:
        OUT.print(
            f"Parity on {manifest.parity.windows} held-out windows: largest difference "
            f"{manifest.parity.largest_difference:g} counts (allowed {manifest.parity.tolerance:g})."
        )
    OUT.print(f"Next: taxel serve --repository {repository}", soft_wrap=True)
