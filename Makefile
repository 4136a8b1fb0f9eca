# make demo   sets everything up and runs the main job end to end
# make test   sets everything up and passes the tests
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO ?= demo

# Tests and benchmarks start many processes: none has to compile the package anew.
export PYTHONDONTWRITEBYTECODE =

.PHONY: help demo test check lint fix bench results schemas docs clean
.DEFAULT_GOAL := help

help:  ## what there is to make
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "coordlog needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(READY)

demo: $(READY)  ## the whole path, from recording to pictures, in demo/
	BIN=$(BIN) sh docs/demo.sh $(DEMO)

test: $(READY)  ## all tests, under five minutes on two cores
	$(BIN)/python -m pytest -n 2 --dist worksteal

check: lint test  ## format, lint, types, tests: what has to pass before a change lands

lint: $(READY)  ## format, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

fix: $(READY)  ## format and repair what can be repaired
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(READY)  ## speed, as ratios measured in one run
	$(BIN)/python -m experiments.speed

results: $(READY)  ## measure the shipped policies on held-out goals again, write docs/results.md
	$(BIN)/python -m experiments.ship
	$(BIN)/python -m experiments.report

schemas: $(READY)  ## write anew what is generated: schemas/ and the tables in docs/
	$(BIN)/python -m coordlog.record.schema
	$(BIN)/python docs/reference/generate.py

docs: $(READY)  ## the documentation as a site, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

clean:  ## remove what was built (not logs)
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache build dist site
