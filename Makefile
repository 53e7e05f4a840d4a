# Everything in one virtual environment, with pinned versions.
PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed

.PHONY: demo test check bench clean

# Train mice on cheese in the corner, test them on cheese anywhere, report what they pursue.
demo: $(INSTALLED)
	$(BIN)/astray reproduce maze-corner --size smoke

# All checks, then all tests.
test: check
	$(BIN)/python -m pytest -n 2

check: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/typos
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

# Speed beside EnvPool (its Procgen needs Debian's libqt5gui5) and Stable-Baselines3.
bench: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt envpool
	$(BIN)/astray bench environments
	$(BIN)/astray bench training

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable . --group dev
	touch $@

clean:
	rm -rf .venv reports runs
