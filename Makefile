# Everything runs in .venv, which is made by the first target that needs it; tests and tools add what they need to it.
.DEFAULT_GOAL := help
.PHONY: help setup dev demo test quick check format bench corpus planners study nightly screenshot clean
.DELETE_ON_ERROR:

ENV := .venv
BIN := $(ENV)/bin
MADE := $(ENV)/.made
DEV := $(ENV)/.dev
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
PYTHON ?=
SPREAD := -n auto --maxprocesses 4 --dist worksteal

help:  ## list the targets
	@grep -hE '^[a-z]+: .*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+): .*## (.*)/make \1\t\2/' | expand -t 18

setup: $(MADE)  ## make the environment (every other target does this when it is needed)

# Rebuilt when what is to be installed changes. Versions are those of constraints.txt.
$(MADE): pyproject.toml constraints.txt
	@for python in $(PYTHON) python3 python3.13 python3.12 python3.11 ''; do \
	    "$$python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && break; \
	done; \
	if [ -z "$$python" ]; then \
	    echo "No Python from 3.11 on, with its venv module, was found. Install one (on Debian: python3 and" >&2; \
	    echo "python3-venv), or name it: make PYTHON=/path/to/python3" >&2; \
	    exit 1; \
	fi; \
	echo "making $(ENV) with $$python (once: 1.7 GB, some minutes where packages must be downloaded)"; \
	"$$python" -m venv --clear $(ENV)
	@$(INSTALL) -e .
	@touch $@

dev: $(DEV)  ## add what tests and tools need (every other target does this when it is needed)

$(DEV): $(MADE)
	@echo "adding what tests and tools need to $(ENV) (once: 0.8 GB)"
	@$(INSTALL) -e '.[dev]'
	@touch $@

demo: $(MADE)  ## improve a recorded path and write the comparison to out/
	$(BIN)/replay optimize recordings/bay_01.mcap --out out
	@echo
	@echo "Open it with: $(BIN)/rerun out/bay_01.rrd"

test: $(DEV)  ## run the tests
	$(BIN)/python -m pytest $(SPREAD)

quick: $(DEV)  ## run the tests but for those that take seconds each
	$(BIN)/python -m pytest $(SPREAD) -m 'not slow'

check: $(DEV)  ## everything that must pass: format, lint, types, tests, what the tests cover
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/basedpyright
	$(BIN)/python -m pytest $(SPREAD) --cov --cov-report=
	$(BIN)/python tools/coverage_table.py

format: $(DEV)  ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(DEV)  ## measure speed and quality
	$(BIN)/python tools/bench/collision.py
	$(BIN)/python tools/bench/steering.py
	$(BIN)/python tools/bench/shortcut.py recordings/*.mcap
	$(BIN)/python tools/bench/optimisers.py recordings/*.mcap
	$(BIN)/python tools/bench/ddp.py recordings/*.mcap
	$(BIN)/python tools/bench/cpo.py recordings/*.mcap
	$(BIN)/python tools/bench/reading.py

corpus: $(DEV)  ## make the recorded logs in recordings/ again
	$(BIN)/python tools/make_corpus.py

planners: $(DEV)  ## compare the planners that make the logs; writes the table in recordings/README.md
	$(BIN)/python tools/compare_planners.py

study: $(DEV)  ## run all methods over the full corpus and write recordings/STUDY.md and STUDY_OBSTACLES.md
	$(BIN)/python tools/study.py
	$(BIN)/python tools/study.py --part obstacles

nightly: $(MADE)  ## run the regression over all logs in recordings/; keeps the run in runs/
	$(BIN)/replay regress recordings --jobs 2

screenshot: demo $(DEV)  ## make docs/overview.png from the demo's recording (needs a Vulkan driver)
	$(BIN)/python tools/screenshot.py out/bay_01.rrd docs --tab Overview --timeline progress --at 600

clean:  ## remove the environment, caches and output
	rm -rf $(ENV) out .pytest_cache .ruff_cache .hypothesis .coverage* build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
