"""`taxel load` and `taxel unload`: which versions a running server has."""

from typing import Annotated

import typer

from taxel.administration import Action, Order, give_order
from taxel.artifacts import is_name, is_version
from taxel.commands.cli import ERR, OUT, Json, print_json
from taxel.errors import SettingsError
from taxel.remote import connect

Version = Annotated[str, typer.Argument(metavar="NAME[/VERSION]", help="A model, or one version of it.")]
Endpoint = Annotated[
    str, typer.Option("--connect", metavar="ENDPOINT", help="A running server, as tcp/HOST:PORT.")
]


def load(
    model: Version,
    connect: Endpoint = "tcp/127.0.0.1:7447",
    shadow: Annotated[
        bool, typer.Option(help="Let it answer only copies of the model's requests, to be compared.")
    ] = False,
    timeout: Annotated[
        float, typer.Option(min=0.1, max=86_400, help="Seconds to wait until it serves.")
    ] = 300.0,
    as_json: Json = False,
) -> None:
    """Load a version into a running server, beside those that it serves; the newest one, if none is named.

    Then requests that name no version go to it, if it is the newest. A version that is loaded already is
    loaded again. If it cannot be served, the server goes on as before, and this command tells the reason.
    """
    _give("load", model, connect, timeout, as_json, shadow=shadow)


def unload(
    model: Version,
    connect: Endpoint = "tcp/127.0.0.1:7447",
    timeout: Annotated[float, typer.Option(min=0.1, max=86_400, help="Seconds to wait.")] = 30.0,
    as_json: Json = False,
) -> None:
    """Take a version from a running server; the one that answers, if none is named.

    Requests that have it already are answered. It stays away until it is loaded by name.
    """
    _give("unload", model, connect, timeout, as_json)


def _give(
    action: Action, model: str, endpoint: str, timeout: float, as_json: bool, *, shadow: bool = False
) -> None:
    name, slash, version = model.partition("/")
    if not is_name(name) or (slash and not is_version(version)):
        raise SettingsError(f"{model!r}: expected NAME or NAME/VERSION")
    with connect(endpoint) as source, ERR.status(f"{action}ing {model}"):
        settled = give_order(source, Order(action, name, version or None, shadow), timeout)
    if as_json:
        print_json({"name": name, "version": settled, "action": action, "shadow": shadow})
    else:
        served = "answers copies of requests" if shadow else "is served"
        what = served if action == "load" else "is unloaded"
        OUT.print(f"{name}/{settled} {what}", markup=False, soft_wrap=True)
