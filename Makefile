# Two commands: `make report` runs the main job, `make test` passes the tests, the quick ones; `make test-all` passes
# the others too. `make docs` builds the manual.
# All set up what they need in .venv first, and reuse it afterwards: requirements.lock is what a run needs,
# requirements-docs.lock that and what the manual is made with, requirements-dev.lock all that the tests need.

PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.14 python; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1 \
	&& { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
READY_FOR_DOCS := $(VENV)/.ready-for-docs
READY_FOR_TESTS := $(VENV)/.ready-for-tests
HOW := the commands: $(BIN)/bayestissue --help, or make shell and then bayestissue --help
REPORTS := reports

.DEFAULT_GOAL := help
.PHONY: help setup setup-dev shell report report-example report-arma report-published test test-all run-tests run-slow-tests check-code check-benchmarks docs docs-reports docs-outputs test-long release-check evidence evidence-check evidence-status evidence-pages evidence-peers lock clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(READY)  ## create the environment in .venv
	@echo "$(HOW)"

setup-dev: $(READY_FOR_TESTS)  ## the same, and all that the tests and `make check-code` need
	@echo "$(HOW)"

shell: $(READY)  ## a shell in which `bayestissue` is found
	@echo "in this shell bayestissue is on the PATH; exit leaves it"
	@VIRTUAL_ENV="$(CURDIR)/$(VENV)" PATH="$(CURDIR)/$(BIN):$$PATH" $${SHELL:-sh} || true

$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "bayestissue needs Python 3.12 or newer on the PATH (or: make PYTHON=/path/to/python3.12 ...)"; exit 1; }
	@echo "setting up $(VENV) with $$($(PYTHON) --version), some minutes the first time ..."
	@$(PYTHON) -m venv $(VENV)
	@$(PYTHON) tools/install.py $(VENV) requirements.lock
	@touch $@

$(READY_FOR_DOCS): $(READY) requirements-docs.lock
	@$(PYTHON) tools/install.py $(VENV) requirements-docs.lock
	@touch $@

$(READY_FOR_TESTS): $(READY) requirements-dev.lock
	@$(PYTHON) tools/install.py $(VENV) requirements-dev.lock
	@touch $@

# No part needs another: each takes one core, and what they print follows one after the other.
report: $(READY)  ## the main job: the example campaign fitted in two ways, and the published estimates, in reports/
	@echo "fitting the example campaign in two ways and re-analysing the published estimates, some minutes ..."
	@$(MAKE) --no-print-directory -j2 $(if $(filter output-sync,$(.FEATURES)),--output-sync=target) report-example report-arma report-published
	@$(BIN)/bayestissue compare $(REPORTS)/example $(REPORTS)/example-arma --out $(REPORTS)/comparison --overwrite
	@echo "open report.html in $(REPORTS)/example, $(REPORTS)/comparison and $(REPORTS)/published"
	@echo "$(HOW)"

report-example: $(READY)
	@$(BIN)/bayestissue fit data/example --out $(REPORTS)/example --overwrite

report-arma: $(READY)
	@$(BIN)/bayestissue fit data/example --model arma --out $(REPORTS)/example-arma --overwrite

report-published: $(READY)
	@$(BIN)/bayestissue reproduce --out $(REPORTS)/published --overwrite

# Types are one process's work and tests two processes', so that neither leaves a core idle.
test: $(READY_FOR_TESTS)  ## style, types, import order and the quick tests, some five minutes the first time
	@$(MAKE) --no-print-directory -j2 check-code run-tests

test-all: test run-slow-tests  ## the slow tests too, twenty minutes or so more

run-tests: $(READY_FOR_TESTS)
	@echo "quick tests, three minutes the first time, when all is compiled ..."
	@$(BIN)/python -m pytest

run-slow-tests: test check-benchmarks
	@echo "slow tests, twenty minutes or so ..."
	@$(BIN)/python -m pytest -m "slow and not long"

check-code: $(READY_FOR_TESTS)
	@echo "style ..."
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@echo "types, a minute or two the first time ..."
	@$(BIN)/mypy
	@echo "import order ..."
	@$(BIN)/lint-imports

# Scripts of hours, which no test runs: that they call what the program has is seen from types.
check-benchmarks: $(READY_FOR_TESTS)
	@echo "types of the benchmarks, a minute ..."
	@$(BIN)/mypy --config-file benchmarks/mypy.toml

# A warning, such as of a broken link, is an error.
DOCS := $(BIN)/python -m sphinx --fail-on-warning --nitpicky --keep-going --quiet

docs: $(READY_FOR_DOCS)  ## the manual, in docs/_build/html
	@echo "building the manual, a minute or so ..."
	@$(DOCS) docs docs/_build/html
	@echo "open docs/_build/html/index.html"

docs-reports: $(READY)  ## the reports that the manual shows, made anew in docs/reports
	@$(MAKE) --no-print-directory report-example report-published REPORTS=docs/reports

docs-outputs: $(READY_FOR_TESTS) docs-reports  ## these, the manual's pictures, figures and notebook, and what its commands print
	@$(BIN)/python tests/docs/refresh.py
	@$(BIN)/python docs/explanation/figures.py

test-long: $(READY_FOR_TESTS)  ## the checks that take minutes to hours
	@$(BIN)/python -m pytest -m long -n 0

release-check: $(READY_FOR_TESTS)  ## the self-test of the built wheel on each Python of a release; a missing one fails
	@$(BIN)/tox run --skip-missing-interpreters false

EVIDENCE = PYTHONPATH=benchmarks $(BIN)/python -m evidence

evidence: $(READY_FOR_TESTS)  ## measure what is stale: two hours from nothing, or NAME=coverage_fit for some
	@$(EVIDENCE) run $(if $(findstring command,$(origin NAME)),$(NAME))

evidence-check: $(READY)  ## whether the program's numbers are those on which the evidence rests, in two minutes
	@$(EVIDENCE) check

evidence-status: $(READY)  ## which evidence is of this version, and what has changed since
	@$(EVIDENCE) status

evidence-pages: $(READY)  ## write the figures into sentences of the README and the manual, before a release
	@$(EVIDENCE) pages

evidence-peers: $(READY_FOR_TESTS)  ## install the other programs that evidence of speed is measured beside
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.lock

LOCK := uv pip compile pyproject.toml --universal --python-version 3.12 --no-emit-index-url --no-header --upgrade

lock:  ## resolve the pinned versions anew (needs uv)
	$(LOCK) --group dev --output-file requirements-dev.lock
	$(LOCK) --group docs --constraints requirements-dev.lock --output-file requirements-docs.lock
	$(LOCK) --group build --constraints requirements-dev.lock --output-file requirements.lock

clean:  ## remove the environment and caches
	rm -rf $(VENV) docs/_build .pytest_cache .ruff_cache .mypy_cache .hypothesis
