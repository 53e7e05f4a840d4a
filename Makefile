# Everything in one virtual environment, with pinned versions.
PYTHON ?= python3
BIN := .venv/bin
PIP = $(BIN)/python -m pip install --quiet
CORE := .venv/core
INSTALLED := .venv/installed

.PHONY: demo test tested quick pictures games compiled thorough fuzz attack golden check lint docs bench wheel lowest sbom notebooks clean

# Train mice on cheese in the corner, test them on cheese anywhere, report what they pursue.
demo: $(INSTALLED)
	$(BIN)/astray reproduce maze-corner --size smoke

# All checks, the documentation, and all tests, with what needs no other at once.
test:
	$(MAKE) --no-print-directory --jobs 3 tested check docs

# Two workers on two cores: a third fills the moments in which tests wait for pages and processes,
# but then the tests need a tenth more core time. A second thread in each would wait for a core, and
# keep it busy. A worker begins with many tests in a row, so that most of what they share is made
# once. What Python has parsed is kept, as tests start many processes.
test tested quick thorough fuzz: export ASTRAY_ART ?= $(CURDIR)/.art
test tested quick thorough fuzz: export OMP_NUM_THREADS ?= 1
test tested quick thorough fuzz: export PYTHONDONTWRITEBYTECODE =
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal
WORKERS = 2

tested: compiled
	$(PYTEST)

# What tests run compiled. Games need the core alone, so they compile while the rest is installed,
# which for a moment takes the core's own place from Python's path.
games: $(CORE)
	cd tests && PYTHONPATH=../src ../$(BIN)/python -m helpers.compiled games

compiled: games pictures
	cd tests && ../$(BIN)/python -m helpers.compiled rest

# The original's, for tests that compare images with them: fetched where the package index answers;
# where it does not, these are skipped.
pictures: $(INSTALLED)
	-$(BIN)/astray art import

# What `make test` leaves out: longer ways, and other cases, of what it does test.
thorough: compiled
	$(PYTEST) -m thorough

# An answer within a minute or two: linters, and tests of rules, levels, pictures, kernels, formulas
# and the agency measure, in folders that start no process and train nothing. It says nothing of
# environments, training, checkpoints, analysis, experiments, the command line, types or documentation.
QUICK := src tests/agency tests/kernel/test_kernel.py tests/art/test_art.py tests/games/test_reference.py \
	tests/training/test_ppo.py tests/test_house.py
quick: lint
	$(PYTEST) $(QUICK)

# A million inputs, and a training that is killed a hundred times; half an hour.
fuzz: $(INSTALLED)
	rm -f fuzz.jsonl
	ASTRAY_FUZZ=150 ASTRAY_FUZZ_LOG=fuzz.jsonl $(PYTEST) tests/fuzz
	ASTRAY_FUZZ=2 ASTRAY_LAB_MESSAGES=20000 $(PYTEST) tests/games tests/envs tests/lab/test_session.py
	ASTRAY_KILLS=100 $(BIN)/python -m pytest tests/training/test_checkpoints.py -k killed
	cd tests && ../$(BIN)/python -m helpers.golden --batch 256 --threads 2
	cd tests && NUMBA_DISABLE_JIT=1 ../$(BIN)/python -m helpers.golden --steps 100
	cat fuzz.jsonl

# Some 8,800 attempts to lose a user's data, to crash, to hang, to be silent; a quarter of an hour.
attack: $(INSTALLED)
	cd tests && ../$(BIN)/python -m attack ../attacked --kept ../attacked/kept

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/typos
	$(BIN)/lint-imports

# Write all digests anew, after a change of levels, pictures or rewards that is meant.
golden: $(INSTALLED)
	cd tests && ../$(BIN)/python -m helpers.golden --write

check: lint
	$(BIN)/pyrefly check --python-interpreter-path $(BIN)/python

# The documentation, to site/index.html; a dead link is an error.
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Speed beside EnvPool (its Procgen needs Debian's libqt5gui5) and Stable-Baselines3.
bench: $(INSTALLED)
	$(PIP) --constraint constraints.txt envpool
	$(BIN)/astray bench environments
	$(BIN)/astray bench train

# The wheel and the source archive, checked; then the wheel in a bare environment, tried: its core
# alone, then what trains.
wheel: VERSIONS ?= constraints.txt
wheel: $(INSTALLED)
	rm -rf dist
	$(BIN)/python -m build --quiet
	$(BIN)/twine check --strict dist/*
	rm -rf .bare && $(PYTHON) -m venv .bare
	.bare/bin/python -m pip install --quiet --constraint $(VERSIONS) dist/*.whl
	.bare/bin/python packaging/smoke.py --core
	.bare/bin/python -m pip install --quiet --constraint $(VERSIONS) "$$(ls dist/*.whl)[train]"
	.bare/bin/python packaging/smoke.py
	rm -rf .bare

# The same with the oldest versions that `pyproject.toml` admits.
lowest: $(INSTALLED)
	$(BIN)/python packaging/lowest.py > .venv/lowest.txt
	$(MAKE) --no-print-directory wheel VERSIONS=.venv/lowest.txt

# What an installation of the newest allowed versions holds: dist/sbom.json, in CycloneDX's format.
sbom:
	rm -rf .bare .sbom && $(PYTHON) -m venv .bare && $(PYTHON) -m venv .sbom
	.bare/bin/python -m pip install --quiet '.[train]'
	.sbom/bin/python -m pip install --quiet cyclonedx-bom
	mkdir -p dist
	.sbom/bin/cyclonedx-py environment --pyproject pyproject.toml --output-file dist/sbom.json \
		.bare/bin/python
	rm -rf .bare .sbom

# Run the notebooks at their full size, and save them with their outputs.
notebooks: $(INSTALLED)
	ASTRAY_NOTEBOOKS=full ASTRAY_NOTEBOOKS_OUT=$(CURDIR)/examples/notebooks \
		$(BIN)/python -m pytest -n 0 tests/examples/test_notebooks.py -k runs -m thorough --durations=0

# Without compiling all of Python's files, which is nearly half of installing: few are imported.
$(INSTALLED): $(CORE)
	$(PIP) --no-compile --constraint constraints.txt --editable '.[train]' --group dev
	touch $@

$(CORE): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(PIP) --upgrade 'pip>=25.1'
	$(PIP) --no-compile --constraint constraints.txt --editable .
	touch $@

clean:
	rm -rf .venv .bare .sbom attacked compared dist reports runs site sweeps
