"""What runs with `taxel[server]`, on every Python."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from environments import Environment, Failed

ROOT = Path(__file__).resolve().parents[2]

# Tests that need what serving needs, and XGBoost as the judge of trees.
TESTS = (
    "tests/clients",
    "tests/server/trees/test_exactness.py",
    "tests/server/test_local.py",
    "tests/end_to_end/test_shipped.py",
)
OTHER_EXTRAS = (
    *("gazebo", "ros2", "watch", "test_adapters.py", "test_contacts.py", "test_examples.py"),
    *("test_fingers.py", "test_gymnasium.py", "test_mujoco.py", "test_torch.py"),
    *("test_typescript.py", "test_web_page.py"),
)
"""Of the clients' tests, those that need more."""
FIXTURES = ("tests/conftest.py", "tests/server/conftest.py", "tests/server/trees/conftest.py")
TOOLS = ("pytest", "hypothesis", "xgboost-cpu" if sys.platform == "linux" else "xgboost")

Check = Callable[[Environment], None]


def demo(environment: Environment) -> None:
    """`taxel demo` predicts better than a mean would."""
    said = json.loads(environment.run("taxel", "demo", "--seconds", "1", "--rows", "200", "--json").stdout)
    if not (said["rows"] == 180 and said["norm_mae"] < 0.6):
        raise Failed(f"the demo says {said}; expected 180 rows and norm_mae below 0.6")


def serve(environment: Environment) -> None:
    """Every shipped model answers the same from a server and in process."""
    environment.python(Path(__file__).with_name("served.py"))


def predict(environment: Environment) -> None:
    """`taxel predict` of a simulated recording."""
    environment.run("taxel", "twin", "--rows", "2000", "--seed", "7", "-o", "twin.csv")
    environment.run("taxel", "predict", "twin.csv", "--model", "xgb", "-o", "predicted.csv")
    rows = len((environment.work / "predicted.csv").read_text().splitlines())
    if rows < 1900:
        raise Failed(f"taxel predict wrote {rows} lines; expected about 2000")


def tests(environment: Environment) -> None:
    """The tests that serving needs, from a copy, so that nothing of the checkout is imported."""
    frozen = environment.work / "installed.txt"
    frozen.write_text("\n".join(f"{name}=={version}" for name, version in environment.installed().items()))
    environment.install(*TOOLS, constraints=frozen)
    for test in (*FIXTURES, *TESTS):
        target = environment.work / test
        target.parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (ROOT / test).is_dir() else shutil.copy
        copy(ROOT / test, target)
    ignored = [f"--ignore=tests/clients/{name}" for name in OTHER_EXTRAS]
    options = (*ignored, "-q", "-x", "--import-mode=importlib", "-p", "no:cacheprovider")
    environment.python("-m", "pytest", "-o", "markers=measured", *options, *TESTS)


CHECKS: tuple[Check, ...] = (demo, serve, predict, tests)
