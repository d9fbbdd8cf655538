"""Pages of the reference that are written from the code: commands, options, errors, schemas, modules."""

import inspect
import json
import re
from pathlib import Path
from typing import Final

import typer
from pydantic import BaseModel
from typer.cli import get_docs_for_click

import taxel.errors
from taxel.commands.cli import build
from taxel.manifest import Manifest
from taxel_models.loop.findings import Findings
from taxel_server.options import ServerOptions
from taxel_server.settings import FILE, PREFIX

MODULES: Final = {
    "taxel": "connect, load, and everything that most users need",
    "taxel.predictor": "what a predictor answers",
    "taxel.windows": "samples, windows, and streams that build them",
    "taxel.contacts": "contact samples from a simulator's contacts",
    "taxel.skin": "the fingertip's shape and electrodes",
    "taxel.fingers": "many fingertips that step together",
    "taxel.mujoco": "fingertips in MuJoCo",
    "taxel.corrections": "the terms of a corrected model",
    "taxel.artifacts": "artifacts on disk",
    "taxel.remote.query_transport": "a transport of your own",
    "taxel_server.transports.memory": "a server without a socket, for tests",
    "taxel_models.recordings": "recordings, read and written",
}
"""The public modules, and what each is for."""

SCHEMAS: Final[dict[str, tuple[type[BaseModel], str]]] = {
    "manifest": (Manifest, "`manifest.json` of an artifact"),
    "report": (Findings, "`report.json` of `taxel loop`"),
}


def write_reference(folder: Path) -> None:
    """Write every page of the reference to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "commands").mkdir()
    index = ["# Commands", "", "Each command explains itself, too: `taxel COMMAND --help`.", ""]
    command = typer.main.get_command(build())
    context = typer.Context(command, info_name="taxel")
    for name, one in sorted(command.commands.items()):  # type: ignore[attr-defined]
        text, *below = re.split(
            r"(?m)^#(?=# `taxel)", get_docs_for_click(obj=one, ctx=context, name=name, call_prefix="taxel")
        )
        index.append(f"- [taxel {name}]({name}.md): {_first_line(one.help)}")
        # A command that has commands would be a long page: each gets a page of its own.
        for page in below:
            own = page.partition("\n")[0].strip("# `").removeprefix("taxel ").replace(" ", "-")
            (folder / "commands" / f"{own}.md").write_text(page)
            called = f"`{own.removeprefix(f'{name}-')}`"
            text = text.replace(f"* {called}:", f"* [{called}]({own}.md):")
        (folder / "commands" / f"{name}.md").write_text(text)
    (folder / "commands" / "README.md").write_text("\n".join(index) + "\n")
    (folder / "options.md").write_text(_options())
    (folder / "errors.md").write_text(_errors())
    for name, (model, what) in SCHEMAS.items():
        schema = json.dumps(model.model_json_schema(), indent=1, ensure_ascii=False)
        (folder / f"{name}.schema.json").write_text(schema + "\n")
        (folder / f"{name}.md").write_text(_schema(name, model, what))
    (folder / "api").mkdir()
    for name in MODULES:
        (folder / "api" / f"{name}.md").write_text(f"# {name}\n\n::: {name}\n")
    lines = [f"- [{name}]({name}.md): {what}" for name, what in MODULES.items()]
    (folder / "api" / "README.md").write_text("\n".join(["# Python", "", *lines, ""]))


def _options() -> str:
    rows = [
        f"| `--{name.replace('_', '-')}` | `{PREFIX}{name.upper()}` | `{name}` | {_shown(field.default)} "
        f"| {field.description} |"
        for name, field in ServerOptions.model_fields.items()
    ]
    return "\n".join(
        [
            "# Options of the server",
            "",
            "Each option of `taxel serve` may be given on the command line, in the environment, or in "
            f"`{FILE}` in the working directory. The first of these that gives it wins.",
            "",
            f"| option | environment | `{FILE}` | default | what it is |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


def _errors() -> str:
    classes = [
        value
        for _, value in inspect.getmembers(taxel.errors, inspect.isclass)
        if issubclass(value, taxel.errors.TaxelError | taxel.errors.InputWarning)
    ]
    classes.sort(key=lambda one: inspect.getsourcelines(one)[1])
    parts = [
        "# Errors",
        "",
        "Every error that Taxel raises on purpose is a `taxel.errors.TaxelError`. Its text says what was "
        "wrong, where, and what was expected.",
        "",
    ]
    for one in classes:
        code = f" `{one.code}` on the wire." if "code" in vars(one) and one.code != "INTERNAL" else ""
        parts += [
            f"## {one.__name__}",
            "",
            f"A kind of `{one.__bases__[0].__name__}`.{code}",
            "",
            # What a caller passes to make one is for those who read the code.
            (inspect.getdoc(one) or "").partition("\n\nArgs:")[0],
            "",
        ]
    return "\n".join(parts)


def _schema(name: str, model: type[BaseModel], what: str) -> str:
    head = f"# {what.replace('`', '')}\n\nThe schema of {what}, [as JSON Schema]({name}.schema.json).\n"
    without_constants = '    options:\n      filters: ["!^_", "!^[A-Z_]+$"]\n'
    return f"{head}\n::: {model.__module__}\n{without_constants}"


def _shown(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return ", ".join(f"`{one}`" for one in value) or "none"
    return f"`{value}`"


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]
