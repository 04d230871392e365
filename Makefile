# Targets for users, developers and CI. Each target first installs what it needs (as root on Debian).
PYTHON  ?= python3
VENV    ?= .venv
BIN     := $(VENV)/bin
ARGS    ?=
ARCH    ?=
WORKERS ?= 4

.PHONY: dry-run demo experiment test test-all check docs format bench deb release lock audit install uninstall clean help

help:            ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 12

dry-run: $(VENV)/.sim     ## fly a complete mission on the embedded simulated vehicle (ARGS="--speedup 4 …")
	$(BIN)/panoexec dry-run --camera dji-x5s-15mm --overlap 0.15 --elevation -90 30 $(ARGS)

demo: $(VENV)/.sim        ## broker, simulated drone, daemon and operator's page, until Ctrl-C (ARGS="--speedup 4 …")
	@.ci/setup broker
	@# Ctrl-C is its documented end, no error of make
	@trap : INT; $(BIN)/panoexec demo $(ARGS) || [ $$? -eq 130 ]

experiment: $(VENV)/.sim  ## reproduce the paper's simulation (installs hugin-tools; ARGS="--scenario all --seeds 5")
	@.ci/setup hugin
	$(BIN)/panoexec experiment $(if $(ARGS),$(ARGS),--scenario 1)

test: $(VENV)/.dev        ## run the tests (installs mosquitto if missing)
	@.ci/setup tests
	@# as collected: whole processes first, so that no long file is left for the end, when other workers have no more
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

test-all: $(VENV)/.dev    ## run every test and campaign that this machine can (hours; ARDUPILOT_SITL, PX4_SITL name autopilots)
	@.ci/setup tests hugin chromium
	@.ci/campaigns $(BIN) $(ARGS)

check: $(VENV)/.dev       ## check lint, formatting, types, import layers and the documentation
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	@.ci/docs $(BIN)/python

docs: $(VENV)/.dev        ## make the documentation's site in build/site/html; a broken link is an error
	@.ci/docs $(BIN)/python

format: $(VENV)/.dev      ## fix lint and formatting
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev       ## run the benchmarks (speed and memory)
	$(BIN)/python -m tests.bench $(ARGS)

deb: $(VENV)/bin/python   ## build dist/panoexec_VERSION_ARCH.deb for this Debian release (ARCH=arm64: for that)
	@.ci/setup deb
	@packaging/deb $(BIN)/python $(ARCH)

release: $(VENV)/.release deb ## package, bill of materials, checksums and their signature in dist/ (KEY=ID of the signing key)
	@packaging/release $(BIN)/python $(KEY)

lock: $(VENV)/.release    ## lock again what the package ships (ARGS=--upgrade: newest versions)
	@packaging/lock $(BIN)/uv $(ARGS)

audit: $(VENV)/.release   ## look up known vulnerabilities of what the package ships
	$(BIN)/pip-audit --strict --require-hashes --disable-pip --requirement packaging/requirements.lock $(ARGS)

install: $(VENV)/bin/python ## install or upgrade without a package, on this machine or into DESTDIR
	@if [ -n "$(DESTDIR)" ]; then packaging/stage $(BIN)/python "$(DESTDIR)"; else packaging/install $(BIN)/python; fi

uninstall:       ## remove the installation, keep configuration and missions (ARGS=purge: delete them too)
	@packaging/uninstall $(ARGS)

clean:           ## remove build products and the virtual environment (keeps missions)
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info

$(VENV)/bin/python:
	@.ci/setup python "$(PYTHON)"
	@echo "making the virtual environment $(VENV)" >&2
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.sim: pyproject.toml | $(VENV)/bin/python
	@.ci/pip $(BIN)/python "installing (once)" --editable '.[sim,report]'
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	@.ci/pip $(BIN)/python "installing (once)" --editable '.[dev]'
	@touch $@ $(VENV)/.sim

$(VENV)/.release: pyproject.toml | $(VENV)/bin/python
	@.ci/pip $(BIN)/python "installing (once)" --editable '.[release]'
	@touch $@
