# Every line below is a plain command; README.md gives the same ones for Windows.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test build build-native lint bench docs regression exits soak importers tools versions native-all windows clean

demo: .venv/installed
	$(BIN)/ndob-fmu demo

build: .venv/installed
	$(BIN)/ndob-fmu build flexible_joint --out build/fmus --systems build/ssp

build-native: .venv/installed
	$(BIN)/ndob-fmu build flexible_joint --target native --systems build/native/ssp

test: .venv/installed-test build lint
	$(BIN)/pytest -n 2 --dist loadfile
	$(BIN)/python -m tests.kernels

lint: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv/installed-test
	$(BIN)/python -m benchmarks.accuracy
	$(BIN)/python -m benchmarks.gallery
	$(BIN)/python -m benchmarks.disturbance_rejection
	$(BIN)/python -m benchmarks.native_calls
	$(BIN)/python -m benchmarks.performance

docs: .venv/installed-test build
	$(BIN)/python docs/fmu_reference.py build/fmus
	$(BIN)/sphinx-build -W -n --keep-going docs build/docs

regression: .venv/installed-test build
	$(BIN)/python fmus/tools/regression.py build/fmus

exits: .venv/installed-test
	$(BIN)/python -m tests.helpers.native_host 100

soak: .venv/installed-test build
	$(BIN)/python -m tests.fuzz --calls 100000 --seed 1 --fmus build/fmus
	$(BIN)/python -m tests.attacks.states --trials 5000 --seed 1 --fmus build/fmus
	$(BIN)/python -m tests.attacks.texts --trials 20000 --seed 1 --fmus build/fmus
	$(BIN)/python -m tests.attacks.names --trials 1000 --seed 1
	$(BIN)/python -m tests.attacks.steps --trials 2000 --seed 1 --fmus build/fmus
	$(BIN)/python -m tests.soak --steps 1000000 --fmus build/fmus
	$(BIN)/python -m tests.attacks.native --calls 100000 --trials 5000 --seed 1
	$(BIN)/python -m tests.native_soak --steps 10000000
	$(BIN)/python -m pytest -n 2 --hypothesis-profile soak tests/analysis/test_assumptions.py tests/codegen/test_generated_step.py
	$(BIN)/python -m tests.attacks.archives --trials 1000 --seed 1
	$(BIN)/python -m tests.attacks.bit_flips --trials 2000 --seed 1
	$(BIN)/python -m tests.attacks.study_files --trials 10000 --seed 1
	$(BIN)/python -m tests.attacks.interrupts --trials 20 --seed 1

importers: .venv/installed-test build
	$(BIN)/python -m tests.importers.other_importers

tools: .venv/installed-test
	$(BIN)/python -m tests.importers.tools_page

versions: .venv/installed-test
	$(BIN)/python -m tests.versions

native-all: .venv/installed-test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade --target $(CURDIR)/build/zig ziglang
	PYTHONPATH=$(CURDIR)/build/zig ZIG_GLOBAL_CACHE_DIR=$(CURDIR)/build/zig-cache $(BIN)/python -m pytest tests/native/with_zig.py

windows: .venv/installed-test build
	$(BIN)/python -m tests.windows.machine
	$(BIN)/python -m pytest tests/windows/in_wine.py

clean:
	rm -rf .venv build dist results .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The stamp is written last, so that an interrupted installation is repeated.
.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

.venv/installed-test: pyproject.toml | .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test]"
	touch $@
