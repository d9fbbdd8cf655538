"""What runs with each extra by itself, and what the bare client says of everything else."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE, Popen
from urllib.request import urlopen

from environments import Environment, Failed, environment
from requirements import extras
from serving import ROOT, Check, demo, predict, serve

# Each needs an extra; what it is given need not exist, since that is told first.
REFUSED = {
    "server": ("demo", "serve"),
    "watch": ("watch --demo --no-open",),
    "foxglove": ("watch twin.csv --mcap x.mcap",),
    "rerun": ("watch twin.csv --rerun x.rrd",),
    "plot": (
        "recording twin.csv --plot x.png",
        "predict twin.csv --model xgb -o x.csv --report x",
        "frame -o x.svg",
    ),
    "train": ("train --data twin.csv -o x", "export x --repository x"),
    "loop": (
        "loop --model xgb --repository x --data twin.csv -o x",
        "loop-trial",
        "calibrate twin.csv -o x",
        "twin --effect offset -o x.csv",
    ),
    "study": ("study --data twin.csv -o x", "search --data twin.csv -o x"),
    "ros2": ("ros2", "recording twin.csv -o x.mcap"),
    "gazebo": ("gazebo --world w --finger ff=hand/tip/touch",),
    "bench": (
        "bench run --model xgb",
        "bench table -o x",
        "bench load --scenario single-stream --model xgb",
        "bench compare",
        "bench forms",
        "bench lane",
        "bench chaos",
    ),
}

ENDPOINT = "tcp/127.0.0.1:17447"
CONSTRAINTS = ROOT / "constraints.txt"
SMALL_TREES = "--set n_estimators=5 --set max_depth=3 --set eta=0.5"
SMALL_NETWORK = '--set neurons=[16,16] --set activations=["relu","relu"] --set epochs=1'


def taxel(environment: Environment, command: str) -> None:
    """Run a command that is written as one types it, without quotes."""
    environment.run("taxel", *command.split())


def _twin(environment: Environment, rows: int = 6000) -> None:
    taxel(environment, f"twin --rows {rows} --seed 7 -o twin.csv")


def light(environment: Environment) -> None:
    """Nothing that an extra brings is installed."""
    installed = {name.lower().replace("_", "-") for name in environment.installed()}
    brought = {one.split(">=")[0] for requirements in extras(ROOT).values() for one in requirements}
    heavy = installed & brought
    if heavy:
        raise Failed(f"the bare client installs {', '.join(sorted(heavy))}")


def client(environment: Environment) -> None:
    """What needs no extra; the shipped models are listed, and none as READY."""
    taxel(environment, "--help")
    _twin(environment)
    taxel(environment, "recording twin.csv --json")
    listed = environment.run("taxel", "models").stdout
    if "READY" in listed or "pip install 'taxel[server]'" not in listed or "xgb/1" not in listed:
        raise Failed(f"taxel models lists, without the libraries that evaluate models:\n{listed}")


def refusals(environment: Environment) -> None:
    """Every command that needs an extra names it, in one line."""
    for extra, commands in REFUSED.items():
        for command in commands:
            done = environment.run("taxel", *command.split(), check=False)
            hint = f"pip install 'taxel[{extra}]'"
            if done.returncode != 1 or hint not in done.stderr or "Traceback" in done.stderr:
                raise Failed(f"taxel {command}: exit {done.returncode}, expected {hint}:\n{done.stderr}")


@contextmanager
def _serving(served: Environment, launcher: str = "") -> Iterator[Popen[str]]:
    """`taxel serve` with the shipped models, which listens."""
    # A launcher looks for programs on the PATH.
    program = str(served.folder / "bin" / "taxel")
    command = (*launcher.split(), program, "serve", "--listen", ENDPOINT, "--json")
    # After its first line, all that a server prints goes to stderr.
    process = served.started(*command, stderr=PIPE if launcher else None)
    try:
        if not process.stdout.readline():
            raise Failed("taxel serve ended before it was ready")
        yield process
    finally:
        process.terminate()
        process.communicate()


def served_to_a_bare_client(served: Environment) -> None:
    """A server is asked from an environment with the client alone."""
    with environment(served.interpreter) as bare:
        bare.install(served.wheel, constraints=CONSTRAINTS)
        _twin(bare)
        with _serving(served):
            taxel(bare, f"models --connect {ENDPOINT}")
            taxel(bare, f"predict twin.csv --model ffnn --connect {ENDPOINT} -o predicted.csv")


def _asks_a_server(program: str) -> Check:
    """A program runs in the environment, beside a server in another one."""

    def beside_a_server(asking: Environment) -> None:
        with environment(asking.interpreter) as server:
            server.install(f"{asking.wheel}[server]", constraints=CONSTRAINTS)
            with _serving(server):
                asking.python(ROOT / program, "--connect", ENDPOINT)

    return beside_a_server


def traced(environment: Environment) -> None:
    """OpenTelemetry's launcher starts the server, and prints the span of a request with a trace."""
    told = "--traces_exporter console --metrics_exporter none --logs_exporter none"
    with _serving(environment, f"opentelemetry-instrument {told}") as process:
        environment.python(Path(__file__).with_name("asked_with_a_trace.py"), ENDPOINT)
        process.terminate()
        printed = process.stderr.read()
    if '"name": "infer ffnn"' not in printed:
        raise Failed(f"no span of the request:\n{printed[-1000:]}")


def plots(environment: Environment) -> None:
    """A recording is drawn."""
    _twin(environment)
    taxel(environment, "recording twin.csv --plot twin.png")


def watched(environment: Environment) -> None:
    """The page of the demo is served, with all its files."""
    process = environment.started("taxel", "watch", "--demo", "--port", "0", "--json")
    try:
        address = json.loads(process.stdout.readline())["address"]
        for path in ("", "main.js", "layout.css", "vendor/uPlot.esm.js"):
            with urlopen(address + path, timeout=30) as answer:
                if not answer.read():
                    raise Failed(f"taxel watch serves no {path or 'page'}")
    finally:
        process.terminate()
        process.communicate()


def written_for_foxglove(environment: Environment) -> None:
    """A recording becomes an MCAP file."""
    _twin(environment)
    taxel(environment, "watch twin.csv --mcap twin.mcap")


def written_for_rerun(environment: Environment) -> None:
    """A recording becomes a file of Rerun."""
    _twin(environment)
    taxel(environment, "watch twin.csv --rerun twin.rrd")


def trained_and_exported(environment: Environment) -> None:
    """Trees, a network and an ensemble: trained, exported in every format, predicting."""
    _twin(environment)
    common = "--data twin.csv --jobs 1"
    taxel(environment, f"train --model xgb {common} -o trees {SMALL_TREES}")
    taxel(environment, f"train --model ffnn {common} -o network {SMALL_NETWORK}")
    members = SMALL_NETWORK.replace("--set ", "--set ffnn.")
    taxel(environment, f"train --model ensemble --members ffnn:2 {common} -o ensemble {members}")
    taxel(environment, "export trees --repository mine --name trees")
    taxel(environment, "export trees --repository mine --name trees-onnx --format onnx")
    for name in ("network", "ensemble"):
        taxel(environment, f"export {name} --repository mine --name {name}")
    for name in ("trees", "trees-onnx", "network", "ensemble"):
        taxel(
            environment,
            f"predict twin.csv --model {name} --repository mine -o {name}.csv --report {name}-report",
        )


def trees_alone(environment: Environment) -> None:
    """Trees are trained and exported without torch, and a network's training says what it needs."""
    _twin(environment)
    taxel(environment, f"train --model xgb --data twin.csv --jobs 1 -o trees {SMALL_TREES}")
    taxel(environment, "export trees --repository mine --name trees")
    taxel(environment, "predict twin.csv --model trees --repository mine -o trees.csv")
    command = "train --model ffnn --data twin.csv -o network"
    done = environment.run("taxel", *command.split(), check=False)
    if done.returncode != 1 or "pip install 'taxel[train]'" not in done.stderr:
        raise Failed(f"taxel train --model ffnn: exit {done.returncode}:\n{done.stderr}")


def imported_from_gazebo(environment: Environment) -> None:
    """What reads the Gazebo plugin's networks can be imported."""
    environment.python("-c", "import taxel_exporters.gazebo.importer")


def looped(environment: Environment) -> None:
    """An effect is injected, found and exported; the loop's own trial and calibration run."""
    source = "import shutil; from taxel_models.shipped import shipped_repository as s; "
    environment.python("-c", source + "shutil.copytree(s() / 'network-b', 'mine/network-b')")
    taxel(environment, "twin --rows 20000 --seed 7 --effect offset:2 -o injected.csv")
    taxel(environment, "loop --model network-b --repository mine --data injected.csv -o report")
    taxel(environment, "loop-trial --trials 1 --rows 20000")
    _twin(environment, 20000)
    taxel(environment, "calibrate twin.csv -o calibration")


def loop_exported(environment: Environment) -> None:
    """The corrected model is exported and predicts."""
    taxel(environment, "loop --model network-b --repository mine --data injected.csv -o exported --export")
    taxel(environment, "predict injected.csv --model network-b/2 --repository mine -o corrected.csv")


def studied(environment: Environment) -> None:
    """A study of two folds and a search of three trials, of small trees."""
    _twin(environment)
    sizes = "--set xgb.n_estimators=2 --set xgb.max_depth=3"
    taxel(environment, f"study --data twin.csv -o study --models xgb --inputs 1 --folds 2 --jobs 1 {sizes}")
    held = "--holdout chunks --set n_estimators=2 --set max_depth=3"
    taxel(environment, f"search --data twin.csv -o search --inputs 3 --trials 3 --jobs 1 {held}")


def measured(environment: Environment) -> None:
    """Trees and a network beside the published way; a server under load."""
    for model in ("xgb", "ffnn"):
        taxel(environment, f"bench run --model {model} --batch 1,8 --repetitions 100 --json")
    taxel(environment, "bench load --scenario single-stream --model ffnn --queries 100 --json")
    environment.run("bench", "run", "--model", "network-b", "--repetitions", "100", "--json")


def bagged(environment: Environment) -> None:
    """A recording in a bag and back; a node says that there is no router."""
    _twin(environment)
    taxel(environment, "recording twin.csv -o twin.mcap")
    taxel(environment, "recording twin.mcap -o bag")
    taxel(environment, "recording bag --json")
    done = environment.run("taxel", "ros2", "--fingers", "ff,ff", check=False)
    if done.returncode != 2 or "expected names, each of them once" not in done.stderr:
        raise Failed(f"taxel ros2: exit {done.returncode}:\n{done.stderr}")


def bridged(environment: Environment) -> None:
    """The bridge looks for its network and says that nobody is there."""
    command = "gazebo --world w --finger ff=hand/tip/touch --router tcp/127.0.0.1:9"
    done = environment.run("taxel", *command.split(), "--connect", "tcp/127.0.0.1:9", check=False)
    if done.returncode != 1 or "no server at tcp/127.0.0.1:9" not in done.stderr:
        raise Failed(f"taxel gazebo: exit {done.returncode}:\n{done.stderr}")
    environment.python("-c", "from taxel.gazebo.messages import decode; decode(b'', 'gz.msgs.Contacts')")


EXTRAS: dict[str, tuple[Check, ...]] = {
    "client": (light, client, refusals),
    "server": (demo, serve, predict, served_to_a_bare_client),
    "watch": (watched,),
    "foxglove": (written_for_foxglove,),
    "rerun": (written_for_rerun,),
    "plot": (plots,),
    "trees": (trees_alone,),
    "train": (trained_and_exported, imported_from_gazebo),
    "loop": (looped, loop_exported),
    "study": (studied,),
    "ros2": (bagged,),
    "gazebo": (bridged,),
    "bench": (measured,),
    "mujoco": (_asks_a_server("examples/mujoco_fingertip.py"),),
    "gymnasium": (_asks_a_server("tests/matrix/gymnasium_finger.py"),),
    "otel": (traced,),
}
