# What a person does with the project, one word each. Nothing here needs root or hardware.
#
# The virtual environment is made when it is missing, and brought up to date when
# pyproject.toml or constraints.txt is newer than the last installation.

PYTHON ?= python3
VENV   := .venv
OUT    ?= demo
HIDDEN ?= hidden
KILLS  ?= 200
SEED   ?=
FUZZ   ?= fuzz
SECONDS ?= 180
PIP    := $(VENV)/bin/python -m pip install --disable-pip-version-check --progress-bar on -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo test test-long check docs pictures first-steps test-docs test-pages test-packages bench hidden fuzz kill test-qemu install-service clean

help:  ## this text
	@echo "Gyrorig: what a gyroscope really does, and how far to believe it."
	@echo
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 22
	@echo
	@echo "Then: $(VENV)/bin/gyrorig --help"

demo: $(VENV)/.solver  ## the whole way on an emulated rig; writes demo/ (SEED=7 is another rig)
	@$(VENV)/bin/gyrorig demo --out $(OUT) $(if $(SEED),--seed $(SEED))

# Three at a time on two cores: tests in real time wait most of theirs.
test: $(VENV)/.dev  ## the tests; test-long, test-pages, test-docs and test-packages have the rest
	@$(VENV)/bin/python -m pytest -q -rs -n 3 --dist loadfile --no-loadscope-reorder -m "not bench and not pages and not long"

test-long: $(VENV)/.dev  ## searches for causes over several boards or recordings; minutes
	@$(VENV)/bin/python -m pytest -q -rs -n 2 --dist loadfile -m long

check: $(VENV)/.dev  ## style, types and import contracts
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

docs: $(VENV)/.dev  ## the site, strictly: a broken link is an error; into site/
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict
	@$(VENV)/bin/python -m docs.man
	@echo "site/index.html"

pictures: $(VENV)/.dev  ## docs/img anew: reports, and the status of a session; two minutes
	@$(VENV)/bin/python tests/bench/pictures.py --pictures docs/img

first-steps: $(VENV)/.dev  ## how long a stranger takes, from a fresh clone to a calibration applied in C; minutes
	@$(VENV)/bin/python tests/docs/first_steps.py

test-pages: $(VENV)/.dev  ## pages in a browser; those of docs that come of measured data and the paper, made anew
	@$(VENV)/bin/python -m pytest -q -rs -n 2 --dist loadfile -m pages

test-docs: $(VENV)/.dev  ## every command that the documents print, run as a reader would
	@$(VENV)/bin/python tests/docs/run.py

test-packages: $(VENV)/.dev  ## the wheel with each extra alone, in an environment of its own, on every Python from 3.11 on; minutes
	@$(VENV)/bin/python tests/packages/install.py

bench: $(VENV)/.dev  ## the benchmarks: speed, efficiency, clock error
	@missed=; for script in tests/bench/bench_*.py; do \
		echo "== $$script"; $(VENV)/bin/python $$script || missed="$$missed $$script"; done; \
	$(VENV)/bin/python -m pytest -m bench -s --timeout 1800 || missed="$$missed pytest"; \
	if [ -n "$$missed" ]; then echo "make bench: a bar was missed in:$$missed" >&2; exit 1; fi

hidden: $(VENV)/.dev  ## the long tier of hidden effects: hours (less: LESS="--rounds 1 --a-round 2"); writes docs/discovery-scores.md
	@$(VENV)/bin/python tests/hidden/long_tier.py --out $(HIDDEN) $(LESS)

fuzz: $(VENV)/.dev  ## every parser, SECONDS=180 each, guided by coverage where atheris is; damaged frames by the million
	@$(VENV)/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[fuzz]" || \
		echo "make fuzz: no atheris for this Python: inputs by chance alone" >&2
	@mkdir -p $(FUZZ)
	@nice -n 10 $(VENV)/bin/python tests/fuzz/inject.py --out $(FUZZ)/inject.json
	@$(VENV)/bin/python tests/fuzz/fuzz.py --seconds $(SECONDS) --out $(FUZZ)

kill: $(VENV)/.dev  ## SIGKILL to KILLS=200 real recordings at random moments: what each loses
	@$(VENV)/bin/python tests/bench/kill_recordings.py --kills $(KILLS)

test-qemu: $(VENV)/.dev  ## as root: the service on a machine of its own in qemu, its USB pulled, its power cut; minutes
	@$(VENV)/bin/python tests/qemu/run.py

install-service:  ## as root: the daemon under /opt, its units, rules and user; as often as wanted (ARGS="--root DIR")
	@$(PYTHON) systemd/install.py $(ARGS)

clean:  ## remove the virtual environment, caches and the demo's output
	rm -rf $(VENV) $(OUT) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

$(VENV)/.python:
	@command -v $(PYTHON) >/dev/null || { echo "make: no $(PYTHON) here: install Python 3.11 or newer, or name one with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "make: $$($(PYTHON) --version) is too old: Python 3.11 or newer is needed; name one with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "make: $(PYTHON) cannot make virtual environments: install python3-venv (apt install python3-venv)" >&2; exit 1; }
	@echo "Making $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.solver: $(VENV)/.python pyproject.toml constraints.txt
	@echo "Installing gyrorig and what it needs"
	@$(PIP) -e ".[solver]"
	@touch $@

$(VENV)/.dev: $(VENV)/.python pyproject.toml constraints.txt
	@echo "Installing gyrorig, what it needs and what its tests need"
	@$(PIP) -e ".[solver,fleet,live,docs,dev]"
	@touch $@ $(VENV)/.solver
