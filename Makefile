# `make demo` runs the main job, `make test` the tests; both make the environment they need.

VENV := .venv
BIN := $(VENV)/bin
DEMO := runs/flight_2009_2010
# Processes that share the tests, a file each; 0 runs them in one, where a debugger can stop.
WORKERS := auto
# An environment that has the other samplers as well, for `make bench` alone.
BENCH_PYTHON := $(BIN)/python

# One BLAS thread: the work is spread over processes, and more threads would only compete.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Settings of the caller's shell that would change what runs here.
unexport PYTHONHOME PYTHONPATH PYTHONWARNINGS PYTHONDONTWRITEBYTECODE

# The lock files are made with this uv, from releases no younger than this date: some weeks old, so
# that a bad release has been found and withdrawn before it gets in.
UV_VERSION := 0.13.8
LOCK_NEWEST := 2026-10-24
COMPILE := $(VENV)-lock/bin/uv pip compile --quiet --no-config --universal \
	--python-version 3.11 --fork-strategy fewest --exclude-newer $(LOCK_NEWEST) --upgrade \
	--generate-hashes --no-emit-index-url --no-annotate --no-header \
	--constraint requirements/constraints.txt pyproject.toml requirements/build.in

RUN_READY := $(VENV)/.run-installed
DEV_READY := $(VENV)/.dev-installed
INSTALL := $(BIN)/python -m pip install --quiet --no-input

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test lint format docs bench lock clean

help: ## show these targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(RUN_READY) ## posterior of the eight flight wheel biases, with a report
	$(BIN)/cassini-bayes run $(DEMO).toml --force
	@echo "report: $(DEMO)/report.html"

test: $(DEV_READY) ## all tests (some: ARGS="-k name", in a minute: ARGS="-m quick")
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

lint: $(DEV_READY) ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(DEV_READY) ## put the code into the project's format
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

docs: $(DEV_READY) ## the documentation, in docs/_build/html
	@rm -rf docs/_api
	$(BIN)/sphinx-build -j auto -W --keep-going -q -b html docs docs/_build/html
	@echo "docs: docs/_build/html/index.html"

bench: $(DEV_READY) ## the speed benchmark (other samplers: benchmarks/README.md)
	$(BENCH_PYTHON) benchmarks/telemetry_speed.py --anew $(ARGS)

lock: $(VENV)-lock/.uv-$(UV_VERSION) ## the lock files anew (versions and hashes of every file)
	$(COMPILE) --output-file requirements/run.txt
	$(COMPILE) --all-extras --constraint requirements/run.txt --output-file requirements/dev.txt
	@! grep -nE '://|@ |file:|--(index|extra-index|find-links)' requirements/run.txt requirements/dev.txt \
		|| { echo "a lock file names an address; hashes and versions only" >&2; exit 1; }

clean: ## remove environments, caches and build products; runs stay
	rm -rf $(VENV) $(VENV)-lock build dist docs/_build docs/_api .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find cassini_bayes tests benchmarks docs -name __pycache__ -type d -prune -exec rm -rf {} +

# The first interpreter that is new enough and can make an environment; PYTHON=… chooses another.
$(BIN)/python:
	@for python in $(PYTHON) python3.11 python3 python3.12 python3.13; do \
		if "$$python" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
			echo "environment: $(VENV), $$("$$python" --version)"; \
			exec "$$python" -m venv $(VENV); \
		fi; \
	done; \
	echo "No Python 3.11 or newer with venv was found (looked for: $(PYTHON) python3.11 python3" \
		"python3.12 python3.13). Install one, or name it: make PYTHON=/path/to/python3.11 …" >&2; \
	exit 1

# The stamps are newer than what they were made from only if the installation ended well.
$(RUN_READY): requirements/run.txt pyproject.toml | $(BIN)/python
	@echo "installing the locked requirements (once)"
	$(INSTALL) --require-hashes -r requirements/run.txt
	$(INSTALL) --no-build-isolation --no-deps --no-index --editable .
	@touch $@

# A superset of the run requirements in the same versions, so it stands for both.
$(DEV_READY): requirements/dev.txt pyproject.toml | $(BIN)/python
	@echo "installing the locked development requirements (once)"
	$(INSTALL) --require-hashes -r requirements/dev.txt
	$(INSTALL) --no-build-isolation --no-deps --no-index --editable .
	@touch $(RUN_READY) $@

$(VENV)-lock/.uv-$(UV_VERSION): | $(BIN)/python
	$(BIN)/python -m venv $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet uv==$(UV_VERSION)
	@touch $@
