# Two commands: `make report` runs the main job, `make test` passes the tests.
# Both set up what they need in .venv first, and reuse it afterwards.

PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.14 python; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1 \
	&& { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
REPORTS := reports

.DEFAULT_GOAL := help
.PHONY: help setup report test check-code test-long benchmark benchmark-fit lock clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(READY)  ## create the environment in .venv

$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "bayestissue needs Python 3.12 or newer on the PATH (or: make PYTHON=/path/to/python3.12 ...)"; exit 1; }
	@echo "setting up $(VENV) with $$($(PYTHON) --version) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

report: $(READY)  ## the main job: the example campaign's fit and the published estimates' re-analysis, in reports/
	@$(BIN)/bayestissue fit data/example --model models/arma.toml --out $(REPORTS)/example --overwrite
	@$(BIN)/bayestissue reproduce --out $(REPORTS)/published --overwrite
	@echo "open $(REPORTS)/example/report.html and $(REPORTS)/published/report.html"

test: $(READY) check-code  ## style, types, import order and the test suite
	@$(BIN)/python -m pytest

check-code: $(READY)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

test-long: $(READY)  ## the checks that take minutes to hours
	@$(BIN)/python -m pytest -m long -n 0

benchmark: $(READY)  ## time the likelihood beside its peers (installs them first)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.lock
	@$(BIN)/python benchmarks/likelihood.py

benchmark-fit: $(READY)  ## time a fit beside its peers: half an hour and more
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.lock
	@$(BIN)/python benchmarks/fit_efficiency.py

lock: $(READY)  ## resolve the pinned versions anew (needs uv)
	uv pip compile pyproject.toml --group dev --universal --python-version 3.12 --no-emit-index-url --no-header --upgrade --output-file requirements.lock

clean:  ## remove the environment and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .mypy_cache .hypothesis
