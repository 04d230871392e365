# Everything a newcomer, a developer and CI need; each target installs what it needs first (as root on Debian).
PYTHON  ?= python3
VENV    ?= .venv
BIN     := $(VENV)/bin
ARGS    ?=
WORKERS ?= 4

.PHONY: dry-run experiment test check format bench deb install uninstall clean help

help:            ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 12

dry-run: $(VENV)/.sim     ## fly a complete panorama on the embedded simulated vehicle (ARGS="--speedup 4 …")
	$(BIN)/panoexec dry-run --camera dji-x5s-15mm --overlap 0.15 --elevation -90 30 $(ARGS)

experiment: $(VENV)/.sim  ## repeat the paper's simulation case (installs hugin-tools; ARGS="--scenario all --seeds 5")
	@.ci/setup hugin
	$(BIN)/panoexec experiment $(if $(ARGS),$(ARGS),--scenario 1)

test: $(VENV)/.dev        ## run the tests (installs mosquitto if it is missing)
	@.ci/setup tests
	$(BIN)/pytest -n $(WORKERS) --dist loadfile $(ARGS)

check: $(VENV)/.dev       ## lint, format, types, import directions
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: $(VENV)/.dev      ## put the code in order
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev       ## measure speed and memory, as ratios taken in one run
	$(BIN)/python -m tests.bench $(ARGS)

deb: $(VENV)/bin/python   ## build dist/panoexec_VERSION_ARCH.deb for this Debian: what a vehicle gets
	@.ci/setup deb
	@packaging/deb $(BIN)/python

install: $(VENV)/bin/python ## the same without a package, or an upgrade of it: on this machine, or into DESTDIR
	@if [ -n "$(DESTDIR)" ]; then packaging/stage $(BIN)/python "$(DESTDIR)"; else packaging/install $(BIN)/python; fi

uninstall:       ## take away what install put here; configuration and missions stay (ARGS=purge: nothing does)
	@packaging/uninstall $(ARGS)

clean:           ## remove what the targets made (missions stay)
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info

$(VENV)/bin/python:
	@.ci/setup python "$(PYTHON)"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.sim: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[sim,report]'
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(VENV)/.sim
