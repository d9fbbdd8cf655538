"""The package as a whole: what importing it costs, and what it promises."""

import subprocess
import sys

import pytest

import taxel

HEAVY = (
    "torch",
    "xgboost",
    "pandas",
    "scipy",
    "matplotlib",
    "onnxruntime",
    "numba",
    "typer",
    "rich",
    "zenoh",
)


def test_importing_taxel_pulls_in_no_heavy_package() -> None:
    script = f"import sys, taxel; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_promised_name_exists_and_the_promise_is_sorted() -> None:
    for name in taxel.__all__:
        assert getattr(taxel, name) is not None
    assert sorted(taxel.__all__, key=lambda name: (not name.isupper(), name)) == taxel.__all__
    assert set(taxel._HOME_OF) == set(taxel.__all__)
    assert dir(taxel) == sorted(taxel.__all__)


@pytest.mark.parametrize(
    ("library", "extra"), [("mujoco", "mujoco"), ("gymnasium", "gymnasium"), ("torch", "train")]
)
def test_a_module_whose_library_is_missing_names_its_extra(library: str, extra: str) -> None:
    script = f"import sys; sys.modules[{library!r}] = None; import taxel.{library}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    said = f"taxel.{library} needs {library}: pip install 'taxel[{extra}]'"
    assert done.stderr.strip().endswith(f"taxel.errors.MissingDependency: {said}")
