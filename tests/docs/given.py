"""What the pages take as given, and what makes their commands small enough for a test.

A block that is new runs, whole and as it stands, unless one of these tables says otherwise.
"""

import shutil
import sys
from pathlib import Path
from typing import Final

from taxel_models.loop.effects.registry import NAMES

from .blocks import ROOT

ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""What the pages call a server. The tests run one on a free port."""

ROS: Final = Path(sys.prefix) / "ros2" / "bin" / "python"

OTEL: Final = Path(sys.prefix) / "bin" / "opentelemetry-instrument"

ELSEWHERE: Final = {
    # Lines that another test runs, by how they begin.
    "make ": "test_make.py, in a copy of the checkout",
    "taxel loop-trial --ground ": "test_measured_pages.py, where real recordings are",
    "python -m taxel_models.twin.measured_comparison ": "test_measured_pages.py, where real recordings are",
}

MEASURED: Final = (
    # Pages whose commands need real recordings, which are not shipped: test_measured_pages.py follows them.
    "docs/results/README.md",
    "docs/results/recovery.md",
    "docs/results/study.md",
)

SLOW: Final = frozenset(
    {
        "clients/typescript/README.md",
        "docs/calibration.md",
        "docs/cluster.md",
        "docs/gazebo_bridge.md",
        "docs/install.md",
        "docs/loop.md",
        "docs/models.md",
        "docs/next_recording.md",
        "docs/operations.md",
        "docs/recovery.md",
        "docs/ros2.md",
        "docs/search.md",
        "docs/start.md",
        "docs/study.md",
        "docs/versions.md",
        "docs/your_recordings.md",
    }
)
"""Pages that take ten seconds or more: `make long` follows them. Their commands have their own tests."""

MISSING: Final[dict[str, str]] = {}
"""Lines that are not run because this machine lacks what they need, by how they begin."""

if not ROS.exists():
    MISSING["python -m taxel.ros2.rclpy_node "] = "ROS's wheels are not installed: `make .venv/.ros2`"
if shutil.which("systemctl") is None:
    MISSING["systemctl "] = "systemd is not here"
if not any(Path("/var/lib/apt/lists").glob("*_Packages*")):
    MISSING["apt install "] = "Debian's list of packages is not here"

TEXTS: Final = {
    # Blocks of the language `text`, and `json5`, by page and how they begin, and who looks at them.
    "docs/architecture.md: recording ──> windows": "a drawing",
    "docs/recordings.md:taxel recording PATH": "test_a_synopsis_names_real_options",
    "docs/recordings.md:run.csv:812": "test_damaged_recordings_are_refused_in_these_words",
    "docs/security.md:{": "tests/server/test_replicas.py starts a router with it",
    "docs/simulators.md:InputWarning": "CHECKS of the page",
    "docs/wire.md:{": "a message with what each field is; tests/server/test_wire.py has examples",
    "docs/wire_golden.md:": "tests/server/test_wire.py reads every block",
}

PRELUDES: Final = {
    # What a page's Python examples take as given.
    "clients/README.md": """
import asyncio, taxel
import numpy as np
from taxel.windows import build_windows
source = taxel.connect("tcp/127.0.0.1:7447")
predictor = source.predictor("xgb")
windows = a = b = np.zeros((3, predictor.window.length), np.float32)
""",
    "docs/gazebo.md": """
import numpy as np, taxel
windows, tdc = np.ones((3, 12), np.float32), np.full(3, 1970, np.float32)
""",
    "docs/other_simulators.md": f"""
import runpy, gymnasium, mujoco, taxel, taxel.gymnasium, taxel.mujoco
import numpy as np

class Finger(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    dt = 0.01
    model = mujoco.MjModel.from_xml_string(
        runpy.run_path({str(ROOT / "examples" / "mujoco_fingertip.py")!r})["SCENE"]
    )
    data = mujoco.MjData(model)
    def reset(self, *, seed=None, options=None):
        mujoco.mj_forward(self.model, self.data)
        return np.zeros(1, np.float32), {{}}

env, predictor = Finger(), taxel.load().predictor()
""",
    "docs/replicas.md": "import taxel\n",
    "docs/security.md": "import numpy as np, taxel\nwindows = np.zeros((1, 12), np.float32)\n",
    "docs/recordings.md": """
from taxel_models.recordings import write_ruppel
from taxel_models.twin import simulate
from pathlib import Path
write_ruppel(simulate(300, 1), Path("night_run.csv"))
""",
}

CHECKS: Final = {
    # What a page says in words of what its examples give.
    "README.md": "assert list(dict(zip(taxel.CHANNELS, channels[0].tolist()))) == list(taxel.CHANNELS)",
    "docs/gazebo.md": "assert counts.shape == (3, 21) and abs(warm - counts).max() > 0.01",
    "docs/loop.md": "assert predictor.manifest.version == '2' and channels.shape == (1, 21)",
    "docs/other_simulators.md": "assert observation['channels'].shape == (1, 21)",
    "docs/security.md": "assert server.predictor('xgb').predict(windows).shape == (1, 21)",
    "docs/simulators.md": f"""
assert channels.shape == (64, 21)
import pathlib, warnings
with taxel.load() as models, warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    models.predictor().fingers(1, rate_hz=500).step([[0.0, 0.0, -7.0]], [[0.0, 0.0, 1.0]], dt=0.002)
shown = f"InputWarning: {{told[0].message}}"
assert shown in pathlib.Path({str(ROOT / "docs" / "simulators.md")!r}).read_text(), shown
""",
}

TWIN: Final = "taxel twin --rows 3000 --seed 7 -o mine.csv\n"
_SHIPPED: Final = "$(python -c 'from taxel.local import shipped_repository; print(shipped_repository())')"
_TREES: Final = f"mkdir repository && cp -r {_SHIPPED}/xgb repository/\n"
_GAZEBO: Final = str(ROOT / "tests" / "exporters" / "gazebo" / "conftest.py")
_MATERIALS: Final = """{"name": "materials", "repeat": 4, "steps": [
  {"kind": "column", "column": "material", "value": 1},
  {"kind": "press", "place": {"along_mm": -4, "around_deg": 0}, "force_n": 2,
   "speed_n_s": 20, "hold_s": 3},
  {"kind": "column", "column": "material", "value": 2},
  {"kind": "press", "place": {"along_mm": -4, "around_deg": 0}, "force_n": 3,
   "speed_n_s": 20, "hold_s": 3}]}"""
_ROUTER: Final = (
    "python -c 'import zenoh, time; settings = zenoh.Config();"
    ' settings.insert_json5("mode", "\\"router\\"");'
    ' settings.insert_json5("listen/endpoints", "[\\"tcp/127.0.0.1:7447\\"]");'
    ' settings.insert_json5("scouting/multicast/enabled", "false");'
    ' router = zenoh.open(settings); print("a router", flush=True); time.sleep(600)\'\n'
)

GIVEN: Final = {
    # What is there before a page's first command.
    "docs/calibration.md": "taxel twin --rows 30000 --seed 1 -o mine.csv && cp mine.csv day1.csv\n"
    "taxel twin --rows 12000 --seed 2 -o day2.csv\n",
    "docs/cluster.md": TWIN.replace("3000", "6000") + "cp mine.csv recording.csv\n",
    "docs/gazebo.md": f"""
python -c "import pathlib, runpy; runpy.run_path('{_GAZEBO}')['network_b']().write(pathlib.Path('.'))"
""",
    "docs/gazebo_bridge.md": _ROUTER,
    "docs/load.md": _TREES,
    "docs/loop.md": TWIN.replace("mine.csv", "recording.csv") + _TREES,
    "docs/models.md": TWIN + "taxel train --model ffnn --inputs 1 --data mine.csv -o dense --set epochs=1"
    ' --set neurons=[128,128,32] --set activations=\'["relu","relu","relu"]\'\n',
    # One of the protocols that `taxel loop` chooses from: this loop has no reason to.
    "docs/next_recording.md": 'python -c "from taxel_models.twin.protocol_menu import menu;'
    ' print(menu(3.0)[0].model_dump_json())" > proposed.json\n'
    "taxel twin --rows 6000 --seed 3 --effect drift:2 -o measured.csv\n"
    + _TREES
    + "mv repository/xgb repository/mine\n"
    'sed -i "s/\\"name\\": \\"xgb\\"/\\"name\\": \\"mine\\"/" repository/mine/1/manifest.json\n',
    "docs/recordings.md": "mkdir -p path/to && taxel twin --rows 300 -o path/to/the_file.csv\n",
    "docs/results/README.md": "mkdir -p docs/results models/repository\n"
    f"cp -r {_SHIPPED}/network-b models/repository/\n",
    "docs/results/reload/README.md": _TREES,
    "docs/results/replicas/README.md": _TREES,
    "docs/recovery.md": f"echo '{_MATERIALS}' > materials.json\n"
    "taxel twin --protocol materials.json -o recording.csv\n",
    "docs/operations.md": "pip install 'taxel[server]'\ntaxel serve --listen tcp/127.0.0.1:7447\n"
    "mkdir -p etc/systemd/system\n",
    "docs/ros2.md": _ROUTER,
    "docs/scale.md": _TREES,
    "docs/search.md": TWIN,
    "docs/security.md": _TREES + "python -m trustme -q -i localhost && mv client.pem ca.pem\n"
    "printf 'robot:…\\noperator:turns\\n' > users\n",
    "docs/study.md": TWIN.replace("3000", "9000"),
    "docs/versions.md": _TREES + "for v in 2 3; do cp -r repository/xgb/1 repository/xgb/$v\n"
    'sed -i "s/\\"version\\": \\"1\\"/\\"version\\": \\"$v\\"/" repository/xgb/$v/manifest.json; done\n'
    "taxel serve --repository repository --listen tcp/127.0.0.1:7447\n",
    "docs/your_recordings.md": TWIN + "taxel twin --rows 3000 --seed 8 -o measured.csv\n",
    "clients/typescript/README.md": _TREES,
}

TOGETHER: Final = frozenset(
    {
        "docs/start.md",
        "docs/your_recordings.md",
        "docs/loop.md",
        "docs/twin.md",
        "docs/gazebo.md",
        "docs/security.md",
    }
)
"""Pages whose Python examples work on what their commands have made. Others are one Python program."""

FEW: Final = "few"
"""Of the real recordings, a few: a folder that holds `biotac_slide/` and `lasa_contact/`."""

STAND_INS: Final = {
    # What a page calls a reader's own things, and what a test has instead.
    '["tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447", "tcp/10.0.0.3:7447"]': f'["{ENDPOINT}"]',
    'MemoryServer("repository")': "MemoryServer()",
    'predictor("mine").predict': 'predictor("xgb").predict',
    "timeit.repeat(count, number=20_000, repeat=20,": "timeit.repeat(count, number=20, repeat=2,",
    "tls/0.0.0.0:": "tls/localhost:",
    "tls/robot.example:": "tls/localhost:",
    "tcp/10.0.0.5:": "tcp/127.0.0.1:",
    "--connect ENDPOINT": f"--connect {ENDPOINT}",
    "tcp://HOST:": "tcp://127.0.0.1:",
    "tcp/ROBOT:": "tcp/127.0.0.1:",
    "LASA_FOLDER": f"{FEW}/lasa_contact",
    "--data SLIDE": f"--data {FEW}/trials/biotac_slide",
    "--data D ": f"--data {FEW}/trials/biotac_slide ",
    "--data F ": f"--data {FEW}/trials/biotac_slide ",
    "--model MODEL": "--model ffnn",
    "slide-MODEL-1": "slide-ffnn-1",
    "--repository REPO --data RECORDING -o report": "--repository repository --data recording.csv -o shown",
    "report/next-1-drift-temperature.json": "proposed.json",
    "--into RECORDING": "--into recording.csv",
    # The newest version answers by now; a shadow needs another one that does.
    "taxel load xgb/3 --shadow": f"taxel load xgb/1 --connect {ENDPOINT} &&"
    f" taxel unload xgb/3 --connect {ENDPOINT} && taxel load xgb/3 --shadow",
    "npm ci && npm run build": "npm run build",
    "taxel export trained --repository models": "taxel export dense --repository models",
    # What changes the machine is done in a folder instead.
    "/opt/taxel": "opt/taxel",
    "/etc/": "etc/",
    "packaging/taxel.service": str(ROOT / "packaging" / "taxel.service"),
    "systemctl daemon-reload && systemctl enable --now taxel": "systemctl --root=$PWD enable taxel &&"
    " test -L etc/systemd/system/multi-user.target.wants/taxel.service &&"
    " .$(sed -n 's/^ExecStart=\\(.* serve\\).*/\\1/p' etc/systemd/system/taxel.service) --help",
    "apt install": "apt-cache show",
    "opentelemetry-instrument --": f"{OTEL} --",
    "python -m taxel.ros2.rclpy_node": f"{ROS} -m taxel.ros2.rclpy_node",
}

_EFFECTS: Final = "".join(f" --exclude {name}" for name in NAMES if name not in ("creep", "offset"))
_LITTLE_LOOP: Final = f"--stability 0{_EFFECTS}"
_TWO_CAUSES: Final = "--stability 0" + "".join(
    f" --exclude {name}" for name in NAMES if name not in ("drift", "temperature")
)
_LITTLE_COLUMNS: Final = (
    "--set epochs=1 --set position_column=[4] --set force_column=[4] --set temperature_column=[2]"
    " --set trunk=[4] --set batch_size=4096"
)
_LITTLE_STUDY: Final = (
    "--models network-b,xgb --inputs 1 --folds 3 --set xgb.n_estimators=2 --set xgb.max_depth=3"
    " --set network-b.epochs=1 --set network-b.position_column=[4] --set network-b.force_column=[4]"
    " --set network-b.temperature_column=[2] --set network-b.trunk=[4] --set network-b.batch_size=4096"
)
_LITTLE_FULL_STUDY: Final = (
    f"{_LITTLE_STUDY} --models network-b,xgb,ffnn,transformer --folds 2 --rows 3000"
    ' --set ffnn.epochs=1 --set ffnn.neurons=[8,8] --set ffnn.activations=\'["relu","relu"]\''
    " --set transformer.epochs=1 --set transformer.layers=1 --set transformer.embedding=12"
    " --set transformer.heads=2 --set transformer.hidden=8"
)
_LITTLE_DENSE: Final = '--set epochs=1 --set neurons=[32,32] --set activations=\'["relu","relu"]\''
_LITTLE_TRANSFORMER: Final = (
    "--set epochs=1 --set milestones=[] --set layers=1 --set embedding=12 --set heads=2 --set hidden=8"
)
_LITTLE_TREES: Final = "--overwrite --set n_estimators=10 --set max_depth=6"
_LITTLE_NETWORKS: Final = (
    "--set transformer.epochs=1 --set transformer.layers=1 --set transformer.embedding=12"
    " --set transformer.heads=2 --set transformer.hidden=8"
)

SMALLER: Final = {
    # What is added to commands that begin so; of options that are given twice, the last counts.
    "bench capacity": "--models xgb --rates 100 --seconds 0.1 --most 1"
    " --clients 1 --repository repository --json"
    " > capacity.json",
    "bench capacity --models": "--seconds 0.1 --most 1 --clients 1 --repository repository",
    "bench chaos": "--rows 64 --seconds 1 --payloads 500 --flooders zenoh",
    "bench chaos --only flood": "--rows 64 --seconds 1 --flooders taxel",
    "bench churn": "--clients 2 --rows 64 --repository repository",
    "bench lane": "--rounds 1 --seconds 0.05 --gap-ms 0",
    "bench lane --model xgb --size paper": "--model network-b --rounds 1 --seconds 0.05",
    "bench load": "--queries 24 --repository repository",
    "bench load --scenario server": "--duration 0.2 --clients 1 --repository repository",
    "bench reload": "--loads 1 --calm 1 --rate 50 --repository repository",
    "bench replicas": "--count 2 --loops 1 --seconds 1 --repository repository",
    "bench scale": "--model xgb --measured capacity.json --requests 10000 --latency-bound 1000",
    "bench simulator --json": "--fingers 1,2 --models xgb --seconds 0.1",
    "bench simulator --fingers": "--fingers 2 --seconds 0.1",
    "dask scheduler": "--port 8786 --no-dashboard",
    "dask worker": "--nworkers 1 --no-nanny --no-dashboard",
    "opentelemetry-instrument": "--listen tcp/127.0.0.1:7448",
    "python -m taxel_models.calibration.misaligned_twin": "--twins 1 --rows 30000",
    "python -m taxel_models.study.published_facts": "--rows 12000",
    "python -m taxel_models.twin.measured_comparison": "--rows 12000",
    "taxel check": "--seconds 0.2",
    "taxel demo": "--seconds 1 --rows 200",
    "taxel gazebo": "--router tcp/127.0.0.1:7447",
    "taxel load": f"--connect {ENDPOINT}",
    "taxel loop --model mine --repository repository --data measured.csv -o report": _TWO_CAUSES,
    "taxel loop --model mine --repository repository --data measured.csv -o report --export": _LITTLE_LOOP,
    "taxel loop --model network-b": _LITTLE_LOOP,
    "taxel loop --model xgb --repository REPO": _LITTLE_LOOP,
    "taxel loop --model slide": _LITTLE_LOOP,
    "taxel loop --model slide --repository": f"{_LITTLE_LOOP} --exclude creep",
    "taxel loop-trial": "--trials 1 --rows 5000",
    "taxel loop-trial --ground": f"--data {FEW} --trials 1 --jobs 2",
    "taxel loop-trial --injector foreign": f"--data {FEW} --trials 1 --rows 5000 --jobs 2",
    "taxel search": "--trials 2 --budget 1 --least-budget 1 --set learning_rate=0.001",
    "taxel serve --lane": f"--repository repository --listen {ENDPOINT}",
    "taxel serve --websocket": f"--repository repository --listen {ENDPOINT}",
    "taxel study": _LITTLE_STUDY,
    "taxel study --data SLIDE": _LITTLE_FULL_STUDY,
    "taxel train  --model ffnn": "--set epochs=1",
    "taxel train --model ensemble --members ffnn": "--members ffnn:1,xgb:1 --set ffnn.epochs=1"
    " --set xgb.n_estimators=2",
    "taxel train --model ensemble --members transformer": f"--members transformer:2 {_LITTLE_NETWORKS}",
    "taxel train --model MODEL": f"--overwrite {_LITTLE_DENSE}",
    "taxel train --model ensemble --members xgb": "--overwrite --members xgb:1,ffnn:1 --set ffnn.epochs=1"
    " --set xgb.n_estimators=10 --set xgb.max_depth=6",
    "taxel train --model ffnn --inputs 8": f"--overwrite {_LITTLE_DENSE}",
    "taxel train --model network-b --inputs 8": f"--overwrite {_LITTLE_COLUMNS}",
    "taxel train --model transformer": f"--overwrite {_LITTLE_TRANSFORMER}",
    "taxel train --model xgb": "--set n_estimators=20",
    "taxel train --model xgb --inputs 1 --data D": _LITTLE_TREES,
    "taxel train --model xgb --inputs 1 --data SLIDE": _LITTLE_TREES,
    "taxel train --model xgb --inputs 8 --data SLIDE": _LITTLE_TREES,
    "taxel twin --rows 200000": "--rows 6000",
    "taxel twin --rows 60000": "--rows 12000",
    "taxel twin --effect creep:1": "--rows 3000",
    "taxel unload": f"--connect {ENDPOINT}",
    "taxel watch": "--no-open --port 7450",
}

STARTED: Final = {
    # What runs until somebody ends it, and what it says once it is there.
    "dask scheduler": "Scheduler at",
    "dask worker": "Registered to",
    "python -c 'import zenoh, time": "a router",
    "taxel gazebo": " gives ",
    "taxel ros2": "takes contacts of",
    "taxel serve": "listening on",
    "taxel watch": "Ctrl-C ends it",
    f"{OTEL} ": "listening on",
    f"{ROS} -m taxel.ros2.rclpy_node": ": STALE: ",
}

TELLING: Final = ("bench reload", "bench replicas", "taxel check", "taxel doctor")
"""Commands whose exit code 1 tells of the machine that the test runs on."""
