# Boresight's daily work. Needs Python 3.11 or newer and make; everything else is installed by the targets that need it.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
MADE := $(VENV)/made
# For tests alone, and beside the other packages: among them, PyArrow would load it in every process.
PANDAS := $(VENV)/pandas
export PANDAS_FOLDER := $(CURDIR)/$(PANDAS)
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --no-input
LOCK := CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/pip-compile --quiet --upgrade --allow-unsafe --generate-hashes \
        --no-emit-index-url --no-emit-find-links --strip-extras

# Kernels compile once, for the demo and for every test.
export NUMBA_CACHE_DIR := $(CURDIR)/$(VENV)/kernels
COMPILED := $(VENV)/kernels/compiled
export PYTHONUNBUFFERED := 1
# As the command sets it: with more, three test processes wait for each other, and sums differ in their last bit under load.
export OPENBLAS_NUM_THREADS := 1

# What checks the types of the pages' modules, and sets the formulas of the documentation; node comes with the virtual environment.
NODE_MODULES := frontend/node_modules/.package-lock.json
TSC := $(BIN)/node frontend/node_modules/typescript/bin/tsc --project frontend

# Three processes on two cores, for tests that wait for servers and browsers leave a third of each idle.
# Debian keeps PostgreSQL's own programs off the path.
PYTEST := PATH="$(CURDIR)/$(BIN):$$PATH:$$(echo /usr/lib/postgresql/*/bin | tr ' ' ':')" $(BIN)/pytest --durations 10 --numprocesses 3

KEY ?=
DATABASE ?=

REQUESTS ?= 100000
SEED ?= 1

.PHONY: help demo test lint docs pytest full bench postgresql search fuzz release clean lock machine

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */  \1\t/' | expand -t 14

demo: $(COMPILED)  ## install, make a simulated fleet and serve it on http://127.0.0.1:8000
	@mkdir -p build && (nice $(MAKE) --no-print-directory docs >build/docs.log 2>&1 &)  # is there under /docs a minute later
	@$(BIN)/boresight demo

test: $(MADE)/dev lint machine pytest  ## install everything and run every check: lint, types, import contracts, tests

lint: $(MADE)/dev $(NODE_MODULES)  ## style, format, types (of the pages' modules too) and import contracts
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(TSC)

docs: $(MADE)/docs $(NODE_MODULES)  ## build the documentation, strictly, into build/documentation, which the server shows under /docs
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going -d build/doctrees docs build/documentation

pytest: $(MADE)/dev $(PANDAS)/made $(COMPILED)
	@mkdir -p artefacts
	@for part in backend tests benchmarks; do echo "$$part: $$(find $$part -name '*.py' -print0 | xargs -0 cat | wc -l) lines"; done
	$(PYTEST) --junit-xml=artefacts/tests.xml

full: $(MADE)/dev $(PANDAS)/made $(COMPILED)  ## run the tests with every slow one and all with many examples (an hour)
	$(PYTEST) --full

bench: $(MADE)/dev  ## measure everything beside its peers and write docs/benchmarks.md and docs/capacity.md anew (an hour, on an idle machine)
	$(BIN)/python -m benchmarks.pages

postgresql: $(MADE)/dev $(PANDAS)/made $(COMPILED)  ## run the tests on PostgreSQL instead of SQLite
	@.ci/machine postgresql
	$(PYTEST) --ignore tests/test_wheel.py --store postgresql

search: $(MADE)/dev $(COMPILED)  ## look for new counterexamples to every property (half an hour)
	$(PYTEST) -m hypothesis --hypothesis-profile search

fuzz: $(MADE)/dev  ## send made-up requests to every operation and documents that are nearly right (REQUESTS=100000, SEED=1)
	@mkdir -p artefacts
	$(BIN)/python -m tests.fuzz --requests $(REQUESTS) --seed $(SEED) --json artefacts/fuzz.json

release: $(MADE)/dev docs  ## build the documentation, and wheel, source archive, bill of materials, licences and sums into dist (KEY=FILE signs them, DATABASE=all.zip scans offline)
	$(BIN)/python -m release --out dist $(if $(KEY),--key $(KEY)) $(if $(DATABASE),--database $(DATABASE))

clean:  ## remove what was built, cached and demonstrated; the virtual environment stays
	rm -rf artefacts build dist .demo .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache $(VENV)/kernels
	find backend migrations tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

lock: $(MADE)/dev  ## resolve the newest versions that pyproject.toml allows into the lock files
	$(LOCK) --extra lost-in-space --output-file requirements.lock pyproject.toml
	$(LOCK) --extra bench --extra dev --extra docs --extra lost-in-space --extra object-store --extra postgresql --extra tracing --constraint requirements.lock --output-file requirements-dev.lock pyproject.toml
	$(LOCK) --extra docs --constraint requirements-dev.lock --output-file requirements-docs.lock pyproject.toml
	$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["pandas"], sep="\n")' | \
	    $(LOCK) --constraint requirements-dev.lock --output-file requirements-pandas.lock -

machine: $(MADE)/dev
	@.ci/machine browser
	@.ci/machine postgresql

$(BIN)/python:
	@.ci/machine python "$(PYTHON)"
	$(PYTHON) -m venv $(VENV)

$(PANDAS)/made: requirements-pandas.lock | $(BIN)/python
	rm -rf $(PANDAS)
	$(INSTALL) --require-hashes --only-binary :all: --target $(PANDAS) --requirement requirements-pandas.lock
	@touch $@

$(MADE)/runtime: requirements.lock pyproject.toml | $(BIN)/python
	@echo "Installing what Boresight runs on (about 800 MB on disk)."
	$(INSTALL) --require-hashes --only-binary :all: --requirement requirements.lock
	$(INSTALL) --no-deps --editable .
	@$(BIN)/python -m compileall -q backend/boresight  # as pip does for wheels: a command starts 0.15 s sooner
	@mkdir -p $(MADE) && touch $@

# Nothing to install where the tests' packages are, which include these.
$(MADE)/docs: requirements-docs.lock | $(MADE)/runtime
	$(INSTALL) --require-hashes --only-binary :all: --requirement requirements-docs.lock
	@touch $@

$(NODE_MODULES): frontend/package-lock.json | $(MADE)/docs
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/npm ci --prefix frontend --ignore-scripts --no-audit --no-fund --prefer-offline

$(COMPILED): $(MADE)/runtime $(wildcard backend/boresight/kernels/*.py backend/boresight/cameras/*.py)
	@$(BIN)/boresight warm --data .demo
	@touch $@

$(MADE)/dev: requirements-dev.lock pyproject.toml | $(BIN)/python
	@echo "Installing what Boresight runs on and is tested with (about 1 GB on disk)."
	$(INSTALL) --require-hashes --only-binary :all: --requirement requirements-dev.lock
	$(INSTALL) --no-deps --editable .
	@$(BIN)/python -m compileall -q backend/boresight  # as pip does for wheels: a command starts 0.15 s sooner
	@mkdir -p $(MADE) && touch $@ $(MADE)/runtime
