# Everything a developer or a factory engineer types. `make help` lists it.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
ONCE ?=
PART ?=
BY_FILE := --dist loadfile --no-loadscope-reorder
# Tests wait for services and browsers now and then: one process more than there are cores waits beside the others.
MORE := --numprocesses $(shell echo $$(($$(nproc) + 1))) $(BY_FILE)
# There is a process for each core already.
export OPENBLAS_NUM_THREADS := 1
# Dozens of processes read the same modules: whoever wants none compiled on disk, as images of containers do, waits for each.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup demo demo-robot test test-all check format openapi fleet bench clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(VENV)/.ready ## virtual environment, packages, compiled kernels (some minutes the first time, no time after that)

$(VENV)/.ready: pyproject.toml constraints.txt
	@echo "setting up: packages, a minute or more"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@echo "setting up: kernels and handovers, one to three minutes"
	@$(BIN)/liftwright warmup
	@touch $@

demo: setup ## start the service, plan a lift, then a pile of what cameras saw, keep serving; ONCE=1 stops after the results
	@$(BIN)/python -m app.demo $(if $(ONCE),--once)

demo-robot: setup ## plan, export, execute and replay a lift and a pile, on controllers that stand in for robots; ONCE=1 opens no browser
	@$(BIN)/python -m tests.robot.demo $(if $(ONCE),--once)

test: setup ## what shows its law within a second, on samples: some minutes on two cores
	@$(BIN)/python -m pytest -q $(MORE)

test-all: setup ## every law on the whole of its cases; faults at random, the whole interface fuzzed
	@$(BIN)/python -m pytest -q --all $(MORE)

check: setup ## format, lint, types
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/basedpyright

format: setup ## put code into its format
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

openapi: setup ## write docs/openapi.json anew, after a change of the HTTP interface
	@$(BIN)/python -m app.create_app docs/openapi.json

fleet: setup ## build and run the fleet of docker-compose.yml in containers, break, upgrade and restore it; as root, with podman
	@$(BIN)/python -m tests.deployment.fleet

bench: setup ## benchmarks with progress, into tests/benchmarks/RESULTS.md; PART="lifts kernels" measures these only, "lifts_random --most 40" in pieces
	@$(BIN)/python -m tests.benchmarks $(PART)

clean: ## forget the environment and all plans
	@rm -rf $(VENV) data build *.egg-info
