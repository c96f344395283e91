# The tasks of a developer and of a new user. Nothing here needs root or hardware.
#
# The virtual environment is created when it is missing and updated when pyproject.toml or
# constraints.txt is newer than the last installation.

PYTHON ?= python3
VENV   := .venv
OUT    ?= demo
HIDDEN ?= hidden
KILLS  ?= 200
SEED   ?=
FUZZ   ?= fuzz
SECONDS ?= 180
LOCKED := $(VENV)/bin/python release/locked_install.py --python $(VENV)/bin/python --editable

# Some containers set this variable. Then each program compiles all its modules again.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test test-long check docs pictures first-steps test-docs test-pages test-packages goldens goldens-update bench hidden fuzz kill test-qemu install-service deb wheels lock third-party clean

help:  ## list the targets
	@echo "Gyrorig calibrates gyroscopes with a pan-tilt unit. Targets:"
	@echo
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 26
	@echo
	@echo "Then: $(VENV)/bin/gyrorig --help"

demo: $(VENV)/.solver  ## record, solve and compare on an emulated rig; writes demo/ (SEED=7 is another rig)
	@$(VENV)/bin/gyrorig demo --out $(OUT) $(if $(SEED),--seed $(SEED))

# Three workers on two cores: tests in real time mostly wait.
test: $(VENV)/.dev  ## run the tests; test-long, test-pages, test-docs and test-packages have the rest
	@$(VENV)/bin/python -m pytest -q -rs -n 3 --dist loadfile --no-loadscope-reorder -m "not bench and not pages and not long and not packages"

test-long: $(VENV)/.dev  ## run the tests that need many seconds: searches for causes, plans, twins
	@$(VENV)/bin/python -m pytest -q -rs -n 2 --dist loadfile -m long

check: $(VENV)/.dev  ## style, types, import contracts and plain words
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/python -m tests.prose.check

docs: $(VENV)/.dev  ## build the site into site/; a broken link is an error
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict
	@$(VENV)/bin/python -m docs.man
	@echo "site/index.html"

pictures: $(VENV)/.dev  ## make docs/img again: reports and the status of a session; two minutes
	@$(VENV)/bin/python tests/bench/pictures.py --pictures docs/img

first-steps: $(VENV)/.dev  ## measure the time from a fresh clone to a calibration applied in C; minutes
	@$(VENV)/bin/python tests/docs/first_steps.py

test-pages: $(VENV)/.dev  ## test pages in a browser, and make the pages of measured data and the paper again
	@$(VENV)/bin/python -m pytest -q -rs -n 2 --dist loadfile -m pages

test-docs: $(VENV)/.dev  ## run every command that the documents print
	@$(VENV)/bin/python tests/docs/run.py

test-packages: $(VENV)/.packages  ## install the wheel with each extra in a separate environment, on every Python from 3.11; minutes
	@$(VENV)/bin/python -m pytest -q -rs -m packages tests/packages
	@$(VENV)/bin/python tests/packages/install.py

goldens: $(VENV)/.dev  ## compare what the programs compute with the golden set; minutes (TREE=DIR tests another tree)
	@$(VENV)/bin/python -m tests.goldens.run $(if $(TREE),--tree $(TREE)) $(ARGS)

goldens-update: $(VENV)/.dev  ## make the golden set again, after a change that must change results
	@$(VENV)/bin/python -m tests.goldens.run --update $(if $(TREE),--tree $(TREE)) $(ARGS)

bench: $(VENV)/.dev  ## run the benchmarks: speed, efficiency, clock error
	@missed=; for script in tests/bench/bench_*.py; do \
		echo "== $$script"; $(VENV)/bin/python $$script || missed="$$missed $$script"; done; \
	$(VENV)/bin/python -m pytest -m bench -s --timeout 1800 || missed="$$missed pytest"; \
	if [ -n "$$missed" ]; then echo "make bench: missed a limit in:$$missed" >&2; exit 1; fi

hidden: $(VENV)/.dev  ## score the search on hidden effects: hours (less: LESS="--rounds 1 --a-round 2"); writes docs/discovery-scores.md
	@$(VENV)/bin/python tests/hidden/long_tier.py --out $(HIDDEN) $(LESS)

fuzz: $(VENV)/.dev  ## fuzz every parser, SECONDS=180 each, and millions of damaged frames
	@$(LOCKED) --extras fuzz || \
		echo "make fuzz: atheris is not available for this Python. Inputs are random only." >&2
	@mkdir -p $(FUZZ)
	@nice -n 10 $(VENV)/bin/python tests/fuzz/inject.py --out $(FUZZ)/inject.json
	@$(VENV)/bin/python tests/fuzz/fuzz.py --seconds $(SECONDS) --out $(FUZZ)

kill: $(VENV)/.dev  ## kill KILLS=200 recordings at random moments and measure the loss
	@$(VENV)/bin/python tests/bench/kill_recordings.py --kills $(KILLS)

test-qemu: $(VENV)/.dev  ## as root: test the service in a virtual machine, with USB and power failures; minutes
	@$(VENV)/bin/python tests/qemu/run.py

install-service:  ## as root: install the daemon under /opt with units, rules and user (ARGS="--root DIR")
	@$(PYTHON) systemd/install.py $(ARGS)

deb:  ## build the Debian package dist/gyrorig_*.deb for this system's Python (ARGS="--wheels DIR")
	@$(PYTHON) release/deb.py $(ARGS)

wheels: $(VENV)/.dev  ## download the packages of the service into wheels/ for a computer without a network (ARGS="--arm64 --minor 11")
	@$(VENV)/bin/python release/locked_install.py --download wheels --extras solver,fleet $(ARGS)

lock: $(VENV)/.packages  ## write constraints.txt again (ARGS="--upgrade NAME"), after a change of pyproject.toml
	@$(VENV)/bin/python release/lock.py $(ARGS)

third-party: $(VENV)/.dev  ## write THIRD-PARTY.md again, after a change of constraints.txt
	@$(VENV)/bin/python release/third_party.py

clean:  ## remove the virtual environment, caches and the demo's output
	rm -rf $(VENV) $(OUT) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

$(VENV)/.python:
	@command -v $(PYTHON) >/dev/null || { echo "make: $(PYTHON) is missing. Install Python 3.11 or newer, or name one with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "make: $$($(PYTHON) --version) is too old. Name Python 3.11 or newer with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "make: $(PYTHON) cannot create virtual environments. Install python3-venv (apt install python3-venv)." >&2; exit 1; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.solver: $(VENV)/.python pyproject.toml constraints.txt release/locked_install.py
	@echo "Installing gyrorig and its dependencies"
	@$(LOCKED) --extras solver
	@touch $@

$(VENV)/.dev: $(VENV)/.python pyproject.toml constraints.txt release/locked_install.py
	@echo "Installing gyrorig, its dependencies and those of its tests"
	@$(LOCKED) --extras solver,fleet,ros,tables,live,docs,dev
	@touch $@ $(VENV)/.solver

$(VENV)/.packages: $(VENV)/.dev
	@$(LOCKED) --extras packages
	@touch $@
