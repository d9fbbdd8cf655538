# `make demo` runs the main job; `make test` runs every check. Both set up what they need in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
MODEL ?= xgb

# Python keeps bytecode here even if the machine's settings say otherwise. Without it, each program that the tests
# start compiles all that it imports: `bench run` took 18 s instead of 7.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo install test check unit long coverage docs matrix arm release format artifacts clean

help:
	@echo "make demo      serve a shipped model and replay a recording through it (MODEL=xgb)"
	@echo "make test      install everything; format, lint, types, import contract, tests"
	@echo "make install   install everything into $(VENV): $(BIN)/taxel and $(BIN)/bench"
	@echo "make arm       the compiled runtimes' tests on an emulated ARM processor (needs qemu-user-static)"
	@echo "make long      the tests that make test leaves out: pages that take long are followed"
	@echo "make coverage  the tests again, and which lines they run"
	@echo "make docs      build the documentation site into site/; a link that leads nowhere stops it"
	@echo "make matrix    the wheel on every Python here, and every extra by itself (ARGS=--help)"
	@echo "make release   VERSION=x.y.z: bump, build, check, commit, tag (DRY=1: in a clone)"
	@echo "make format    format and fix what can be fixed"
	@echo "make clean     remove $(VENV) and caches"

demo: $(VENV)/.server
	@$(BIN)/taxel demo --model $(MODEL)

install: $(VENV)/.all
	@echo "Installed. Try: $(BIN)/taxel --help, $(BIN)/bench --help"

# Installing waits for the network, and mypy has one thread: side by side they use both cores.
test:
	@$(MAKE) --no-print-directory -j3 $(VENV)/.all $(VENV)/.ros2 $(VENV)/.typescript
	@$(MAKE) --no-print-directory -j2 check unit

check:
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python packaging/site

# A test file stays on one worker, so that its fixtures are made once. Workers use all cores already: with more
# threads, small products take longer, and at times wait for each other. One test took 43 s once, in place of 3.
unit:
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

# Apart from `make test`: what takes long, even made small, such as what some pages train or measure.
long: $(VENV)/.all $(VENV)/.ros2 $(VENV)/.typescript
	$(BIN)/python -m pytest -n auto --maxprocesses 4 -m long

# ARGS: pytest's arguments, instead of all tests and the shipped models' predictions.
arm: $(VENV)/.all
	@$(BIN)/python tests/arm/emulate.py $(ARGS)

# Apart from `make test`: tracing makes the tests of plain Python half as slow again.
coverage: $(VENV)/.all $(VENV)/.ros2 $(VENV)/.typescript
	$(BIN)/python -m pytest --cov --cov-report=term

docs: $(VENV)/.all
	@$(BIN)/python packaging/site

matrix:
	@$(PYTHON) tests/matrix $(ARGS)

release: $(VENV)/.all
	@test -n "$(VERSION)" || { echo "Name a version: make release VERSION=x.y.z"; exit 2; }
	@$(BIN)/python packaging/release.py $(VERSION) $(if $(DRY),--dry)

format: $(VENV)/.all
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The shipped artifacts, made again from a seed; the same versions give the same files.
SMALL_xgb := --set n_estimators=40 --set max_depth=7 --set eta=0.2
SMALL_ffnn := --set neurons=[256,256,128,128] --set activations=[\"elu\",\"elu\",\"relu\",\"relu\"] \
  --set learning_rate=0.001 --set epochs=12
SMALL_transformer := --set layers=2 --set heads=4 --set embedding=48 --set hidden=96 \
  --set learning_rate=0.0003 --set epochs=5
SMALL_network-a := --set widths=[256,256,256,256,256] --set learning_rate=0.0005 --set epochs=12
SMALL_network-b := --set position_column=[192,192,64] --set force_column=[128,128,64] --set trunk=[128,128] \
  --set learning_rate=0.0005 --set epochs=12 --set milestones=[6,9]
SHIPPED := xgb ffnn transformer network-a network-b

artifacts: $(VENV)/.all
	mkdir -p build
	$(BIN)/taxel twin --rows 292200 --seed 1 -o build/twin.csv
	$(MAKE) --no-print-directory $(SHIPPED:%=artifact-%) $(SHIPPED:%=causal-artifact-%)

artifact-%: $(VENV)/.all
	$(call shipped,$*,1,$*,A small $* model)

# Input combination 6 is the causal one that sees every tick of the past 100 ms.
causal-artifact-%: $(VENV)/.all
	$(call shipped,$*,6,$*-causal,A small causal $* model)

# The family, its input combination, the name of the artifact, and what it is.
define shipped
	$(BIN)/taxel train --model $1 --inputs $2 --data build/twin.csv -o build/$3 --overwrite --jobs 1 $(SMALL_$1)
	rm -rf models/repository/$3
	$(BIN)/taxel export build/$3 --repository models/repository --name $3 --version 1 --description \
	  "$4 of Taxel's twin, a simulated fingertip: not of a real sensor."
endef

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -rf clients/typescript/node_modules clients/typescript/build

# A virtual environment, or a plain word on what is missing for one.
$(BIN)/python:
	@command -v $(PYTHON) >/dev/null 2>&1 || { \
	  echo "Taxel needs Python 3.11 or newer, and '$(PYTHON)' was not found."; \
	  echo "Install it (on Debian: apt install python3 python3-venv), or name it: make PYTHON=python3.12 …"; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "Taxel needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version)."; \
	  echo "Name a newer one: make PYTHON=python3.12 …"; \
	  exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "Python's venv module is missing (on Debian: apt install python3-venv)."; \
	  exit 1; }
	@$(PYTHON) -m venv $(VENV)

# Only what serving needs.
$(VENV)/.server: $(BIN)/python pyproject.toml constraints.txt
	@test -e $(VENV)/.all || echo "Installing what serving needs into $(VENV) …"
	@$(PIP) install -q -c constraints.txt -e '.[server]' || { $(MAKE) -s no-packages; exit 1; }
	@touch $@

# Everything: training, benchmarks, plots, tests. Python compiles a module when it is first imported: most never are.
$(VENV)/.all: $(BIN)/python pyproject.toml constraints.txt
	@echo "Installing everything into $(VENV) …"
	@$(PIP) install -q --no-compile -c constraints.txt -e '.[all,dev]' || { $(MAKE) -s no-packages; exit 1; }
	@touch $@ $(VENV)/.server

# ROS 2 and another author's client of rmw_zenoh, for tests. In an environment of their own, since ROS's wheels
# start every Python of their environment twice. Where there are no such wheels, their tests are skipped.
ROS2 := $(VENV)/ros2
ROS2_TESTS := tests/clients/ros2/requirements.txt
$(VENV)/.ros2: $(BIN)/python $(ROS2_TESTS)
	@echo "Installing ROS 2 for the tests into $(ROS2) …"
	@$(BIN)/python -m venv $(ROS2)
	@$(BIN)/python -c 'import sysconfig; site = sysconfig.get_path("purelib"); print(f"import site; site.addsitedir({site!r})")' \
	  > $$($(ROS2)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/_taxel.pth
	@$(ROS2)/bin/python -m pip --disable-pip-version-check install -q -r $(ROS2_TESTS) \
	  || echo "pip could not install ROS 2: the tests that need it are skipped."
	@touch $@

# The compiler of the client for Node. Where there is no npm or no index, that client's tests are skipped.
$(VENV)/.typescript: $(BIN)/python clients/typescript/package-lock.json
	@if command -v npm >/dev/null 2>&1; then \
	  echo "Installing the TypeScript compiler for the tests …"; \
	  npm ci --silent --no-audit --no-fund --prefix clients/typescript \
	    || echo "npm could not install it: the tests of clients/typescript are skipped."; \
	else echo "There is no npm: the tests of clients/typescript are skipped."; fi
	@touch $@

.PHONY: no-packages
no-packages:
	@echo "pip could not install the packages named above it. Taxel needs a package index once, at set-up:"
	@echo "check the network, or point pip at a mirror (pip config set global.index-url URL)."
