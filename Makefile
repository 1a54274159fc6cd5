# Everything a contributor types. `make` alone lists the targets.
# Needed beforehand: git, make, and Python 3.11 or newer with its venv module.

SHELL := /bin/sh
.DEFAULT_GOAL := help

VENV      := .venv
BIN       := $(VENV)/bin
# Stamps: what was done, so that it is done once and again when its input changes.
CORE      := $(VENV)/.core
FIXEL     := $(VENV)/.fixel
READY     := $(VENV)/.ready
PEERS     := $(VENV)/.peers
DOCS      := $(VENV)/.docs
# The complete lock has every hash, so pip neither resolves nor reads metadata. Python stores bytecode of what it imports;
# pip would compile everything first, for half a minute.
INSTALL    = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# Without stored bytecode each of some hundred processes of the tests compiles the package again.
unexport PYTHONDONTWRITEBYTECODE
# The numerical code needs eight of the packages. It compiles for a minute, once, while the others are installed. If this
# fails, the first simulation compiles, and reports why.
COMPILE    = PYTHONPATH=src $(BIN)/python -c 'import fixel; from fixel.testing.scenes import pushed_square; \
             fixel.Simulator(pushed_square()).ends(duration=1e-3)' >/dev/null 2>&1 </dev/null
# Any of these will do, the first that is new enough and has venv. `make test PYTHON=/path/to/python` picks one.
PYTHON    ?=
PYTHONS   := $(PYTHON) python3 python3.13 python3.12 python3.11
UV_VENV   := build/uv
# Test processes at a time: one more than two cores, since some tests wait for browsers and jobs. A debugger
# wants PYTEST_ARGS="-n 0", which runs all tests in one process.
JOBS      ?= 3
# A test that hangs says where, and fails. The longest takes half a minute, and compiling two more, on a busy machine ten.
PARALLEL   = -n $(JOBS) --dist loadfile --no-loadscope-reorder --max-worker-restart=0 \
             -o faulthandler_timeout=900 -o faulthandler_exit_on_timeout=true
SCRIPTS   := build/scripts/.packages
TSC       := build/scripts/node_modules/typescript/bin/tsc

.PHONY: help demo demo-camera test test-system test-slow test-cluster check lint lint-scripts format house soak bench docs wheel release-check lock clean
.DELETE_ON_ERROR:

help:  ## this list
	@echo "fixel: planar rigid bodies in frictional contact"
	@echo
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1|\2/p' Makefile | \
	while IFS='|' read -r name text; do printf '%-18s %s\n' "$$name" "$$text"; done
	@echo
	@echo "The first target you run also creates $(VENV): the demo from requirements/core.txt, the others from lock.txt."

# With other targets, the demo waits until all packages are there: it would see half of one that is being installed.
demo: $(if $(filter-out demo,$(MAKECMDGOALS)),$(READY),$(FIXEL))  ## from a table of pushes to a plan that works; every claim compared with the truth
	@$(BIN)/fixel demo

demo-camera: $(READY)  ## the whole way: film, record, track, calibrate, compare with the truth
	@$(BIN)/fixel demo --camera

test: $(READY)  ## the tests, and the check that each floor imports only from those below
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/python -m pytest $(PARALLEL) $(PYTEST_ARGS)

test-system: $(READY)  ## tests of whole systems: browsers, PostgreSQL, killed processes, long examples
	@$(BIN)/python -m pytest -m "system and not slow and not soak and not cluster" $(PARALLEL) $(PYTEST_ARGS)

test-slow: $(READY)  ## the tests marked slow, which `make test` leaves out
	@$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

test-cluster: $(READY)  ## campaigns on a real SLURM on this machine, killed and continued (needs slurm-wlm, munge)
	@$(BIN)/python -m pytest -m "not soak" tests/jobs/test_slurm.py $(PYTEST_ARGS)

lint: $(READY)  ## formatting, lint and types
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check --no-cache .  # a cache does not notice a module that moved
	@$(BIN)/mypy
	@$(MAKE) --no-print-directory lint-scripts

# Node checks the types of the scripts of the pages; nothing else needs it. Without it, this says so.
lint-scripts: $(SCRIPTS)
	@if [ -x $(TSC) ]; then node $(TSC) -p requirements/scripts/tsconfig.json; \
	else echo "The types of the scripts are not checked: no Node, or its packages cannot be had."; fi

$(SCRIPTS): requirements/scripts/package-lock.json
	@mkdir -p build/scripts
	@if command -v npm >/dev/null 2>&1; then \
	  cp requirements/scripts/package.json requirements/scripts/package-lock.json build/scripts/ && \
	  (cd build/scripts && npm ci --no-audit --no-fund --silent >npm.log 2>&1) || true; fi
	@touch $@

check: lint test  ## everything a change must pass: lint, then test

format: $(READY)  ## rewrite the code in the house format
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

house: $(READY)  ## figures of structure and language, with their limits; ARGS="--list FIGURE" names the places
	@$(BIN)/python -m tools.house $(ARGS)

soak: $(READY)  ## a million random step problems, then the long tests marked soak
	@$(BIN)/python -m benchmarks.soak $(SOAK_ARGS)
	@HYPOTHESIS_PROFILE=soak $(BIN)/python -m pytest -m soak $(PYTEST_ARGS)

bench: $(READY) $(PEERS)  ## speed and accuracy, compared with the peers; writes CSV under benchmarks/
	@$(BIN)/python -m benchmarks --peers $(BENCH_ARGS)

docs: $(READY) $(DOCS)  ## the documentation site, in build/docs; a warning fails; DOCS_ARGS=-E reads all again
	@$(BIN)/sphinx-build -W --keep-going -n -q -b html -d build/doctrees docs build/docs $(DOCS_ARGS)
	@echo "Open build/docs/index.html"

wheel: $(READY)  ## the package that pip installs, in dist
	@$(BIN)/python -m hatchling build -t wheel -d dist

release-check: $(READY)  ## build, install and run the package as users do; RELEASE_ARGS="--quick" only builds, "--json"
	@$(BIN)/python -m tools.release_check $(RELEASE_ARGS)

lock:  ## resolve requirements/*.txt again from pyproject.toml; LOCK_ARGS=--upgrade for newer versions
	@test -x $(UV_VENV)/bin/uv || { echo "Installing uv into $(UV_VENV) ..."; \
	  python3 -m venv $(UV_VENV) && $(UV_VENV)/bin/python -m pip install --quiet --disable-pip-version-check uv; }
	$(UV_VENV)/bin/uv pip compile $(LOCK) --extra dev pyproject.toml -o requirements/lock.txt
	$(UV_VENV)/bin/uv pip compile $(LOCK) --extra build -c requirements/lock.txt pyproject.toml -o requirements/core.txt
	for extra in bench docs; do $(UV_VENV)/bin/uv pip compile $(LOCK) --extra $$extra -c requirements/lock.txt \
	  pyproject.toml -o requirements/$$extra.txt || exit 1; done
LOCK := --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url $(LOCK_ARGS)

clean:  ## remove the environment, caches and built files
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

# --- the environment -------------------------------------------------------------------------------------

$(BIN)/python:
	@chosen=; \
	for candidate in $(PYTHONS); do \
	  if "$$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    chosen="$$candidate"; break; \
	  fi; \
	done; \
	if [ -z "$$chosen" ]; then \
	  echo "fixel needs Python 3.11 or newer with its venv module; tried: $(strip $(PYTHONS))." >&2; \
	  if command -v python3 >/dev/null 2>&1; then \
	    echo "Found $$(python3 --version 2>&1), which is too old or came without venv." >&2; \
	  else \
	    echo "Found no python3 at all." >&2; \
	  fi; \
	  echo "On Debian or Ubuntu: sudo apt install python3 python3-venv" >&2; \
	  echo "Elsewhere, install Python 3.11 or newer and run: make PYTHON=/path/to/python3" >&2; \
	  exit 1; \
	fi; \
	echo "Creating $(VENV) with $$("$$chosen" --version) ..."; \
	"$$chosen" -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "Could not create $(VENV). On Debian or Ubuntu: sudo apt install python3-venv" >&2; exit 1; }

$(CORE): requirements/core.txt | $(BIN)/python
	@echo "Installing the packages of requirements/core.txt into $(VENV) (once; half a minute) ..."
	@awk '/^[a-z]/ {used = /^(cffi|llvmlite|numba|numpy|pycparser|pyyaml|scipy|shapely)==/} used' \
	  requirements/core.txt >$(VENV)/first.txt
	@$(INSTALL) --no-deps --require-hashes -r $(VENV)/first.txt && { $(COMPILE) & } && \
	$(INSTALL) --no-deps --require-hashes -r requirements/core.txt || { \
	  echo "Installing failed; the reason stands above. Without network, or behind a mirror, set pip up first," >&2; \
	  echo "then run the same command again; it continues where it stopped." >&2; exit 1; }
	@touch $@

$(FIXEL): pyproject.toml $(CORE)
	@echo "Installing fixel itself, editable ..."
	@$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

$(READY): requirements/lock.txt $(FIXEL)
	@echo "Installing the packages of requirements/lock.txt into $(VENV) (once; a minute) ..."
	@$(INSTALL) --no-deps --require-hashes -r requirements/lock.txt
	@touch $@

$(PEERS): requirements/bench.txt | $(READY)
	@echo "Installing the peers of requirements/bench.txt into $(VENV) (once) ..."
	@$(INSTALL) --no-deps --require-hashes -r requirements/bench.txt
	@touch $@

$(DOCS): requirements/docs.txt | $(READY)
	@echo "Installing the packages of requirements/docs.txt into $(VENV) (once) ..."
	@$(INSTALL) --no-deps --require-hashes -r requirements/docs.txt
	@touch $@
