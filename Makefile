# SPDX-License-Identifier: GPL-3.0-or-later
# Every command first sets up what it needs, from PyPI alone; .ci/setup does only what has changed since.
SHELL := bash
.DEFAULT_GOAL := help
.PHONY: help setup demo demo-haptic test test-blender test-window figures bench chart stability package lint clean

BPY ?=
PAGE ?=
BLENDER ?= blender
INPUT ?=
PLATFORMS ?= all
ONLY ?=
PAGE ?=
TESTS ?= tests --ignore tests/bench

VENV := .venv$(if $(BPY),-bpy$(BPY))
PYTHON := $(VENV)/bin/python
PYTHON_FOR_4.5 := 3.11
PYTHON_FOR_5.2 := 3.13
SCENARIOS = $(if $(filter command line,$(origin TESTS)),$(foreach name,$(TESTS),'$(name)'))
PYTEST := $(PYTHON) -m pytest -c tests/pytest.ini

help:
	@echo 'make demo [INPUT=FILE]           push a stroke into Suzanne, or into a .pvm or .vdb: out/demo.vdb, out/demo.png'
	@echo 'make demo-haptic                 press and draw with an arm in software: out/demo-haptic.png, out/demo-haptic.json'
	@echo 'make test [TESTS=tests/core]     all tests, or some, with the bpy wheel'
	@echo 'make test-blender BLENDER=PATH   the Blender tests in a real Blender, on the built and installed extension'
	@echo 'make test-window BLENDER=PATH [TESTS="undo_* esc_*"]  strokes by mouse and keys in a Blender with a window; pictures in out/window'
	@echo 'make figures                     the figures of the paper, into out/figures'
	@echo 'make bench                       speed, into out/bench'
	@echo 'make chart [ONLY=sweep,carve] [PAGE=1]  speed against accuracy, into out/chart; PAGE=1 also into tests/bench/README.md'
	@echo 'make stability [PAGE=1]          which couplings shake an arm, and which do not, into out/stability; PAGE=1 renews tests/bench/STABILITY.md'
	@echo 'make package [PLATFORMS=...]     the extension, dist/repousse-VERSION.zip; PLATFORMS=linux-x64,windows-x64 for those alone'
	@echo 'make lint                        style and types'
	@echo 'make setup                       only the environment that all of these use'
	@echo 'make clean                       remove what these made, but not the environment'
	@echo 'BPY=4.5 or BPY=5.2 with any of them: that bpy, in an environment of its own'

setup:
	@.ci/setup $(VENV) $(if $(BPY),$(or $(PYTHON_FOR_$(BPY)),$(error BPY=$(BPY): there is bpy 4.5 and 5.2)))

demo: setup
	@$(PYTHON) tests/bench/demo.py $(if $(INPUT),"$(INPUT)")

demo-haptic: setup
	@$(PYTHON) -m tests.bench.demo_haptic

test: setup
	@$(PYTEST) $(TESTS)

test-blender: setup
	@$(PYTHON) tests/blender/run.py "$(BLENDER)"

test-window: setup
	@$(PYTHON) -m tests.window.run "$(BLENDER)" $(SCENARIOS)

figures: setup
	@$(PYTHON) tests/bench/figures.py

bench: setup
	@mkdir -p out/bench
	@BLENDER="$(BLENDER)" $(PYTEST) tests/bench --benchmark-json "out/bench/$$(date +%Y%m%d-%H%M%S).json"

chart: setup
	@$(PYTHON) -m tests.bench.chart $(if $(ONLY),--only "$(ONLY)") $(if $(PAGE),--page)

stability: setup
	@$(PYTHON) -m tests.bench.stability $(if $(PAGE),--page)
	@$(PYTHON) -m tests.bench.stability.hard_cases

package: setup
	@$(PYTHON) .ci/package.py --platforms "$(PLATFORMS)" --out dist

lint: setup
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy
	@$(VENV)/bin/clang-format --style=file:core/native/.clang-format --dry-run -Werror core/native/*.c tests/device/shim/*.[ch]

clean:
	@rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks repousse.egg-info
	@find . -name .git -prune -o -path './.venv*' -prune -o -name __pycache__ -type d -exec rm -rf {} +
