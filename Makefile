# Every target sets up .venv by itself, once, and again when a dependency changes.
PYTHON ?= python3
SHAPES ?= 1000
WORKERS ?= 2
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile --no-loadscope-reorder

.PHONY: help demo test slow lint types docs check tables train format setup clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*## ' Makefile | sed -E 's/:.*## /\t/' | expand -t 10

setup: $(STAMP)  ## create .venv with the exact versions of constraints.txt

demo: $(STAMP)  ## encode a cloud, draw Exp and Log, print an error table; SHAPE=path for your own
	$(BIN)/python examples/quickstart.py $(if $(SHAPE),"$(SHAPE)")

test: $(STAMP)  ## run the tests but the slow ones, on WORKERS=2 cores; ARGS passes options to pytest
	$(PYTEST) -m "not slow" $(ARGS)

slow: $(STAMP)  ## run the slow tests, each file in a process of its own; a test that hangs ends it and is named
	grep -rl 'mark\.slow' tests --include='test_*.py' | sort -r | OMP_NUM_THREADS=1 xargs -n 1 -P $(WORKERS) \
		$(BIN)/python -m pytest --no-header -m slow -o faulthandler_timeout=900 -o faulthandler_exit_on_timeout=true $(ARGS)

lint: $(STAMP)  ## formatting and lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)  ## static types
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(STAMP)  ## build the documentation into site/; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

check: lint types docs test slow  ## everything that CI asks for, the demo apart

tables: $(STAMP)  ## the paper's tables with every rival; DIR=shapes or meshes, FAST=1 for a first look
	$(BIN)/python -m riemlayer.tables $(if $(DIR),"$(DIR)") $(if $(FAST),--fast) -o tables

train: $(STAMP)  ## prepare SHAPES=1000 procedural shapes and train `base`; goes on where it stopped
	$(BIN)/python -m riemlayer.data.prepare --procedural $(SHAPES) --seed 0 -o data_cache/procedural
	$(BIN)/python -m lightning_modules fit --config lightning_modules/configs/base.yaml \
		$(if $(wildcard runs/base/last.ckpt),--ckpt_path runs/base/last.ckpt)

format: $(STAMP)  ## put the code into the house format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:  ## remove the environment, the demo's output and the built documentation
	rm -rf $(VENV) demo_output site

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "riemlayer needs Python 3.11 or newer, found " + sys.version.split()[0] + "; name another one with: make PYTHON=python3.11")'
	@echo "Setting up $(VENV) (once; a few minutes)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[data,viz,cli,scale,deploy,docs,dev]"
	@touch $@
