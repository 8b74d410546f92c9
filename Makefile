# slamcmp: `make demo` to see it work, `make test` to run its tests, `make check` for all that CI runs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
PYTEST_ARGS ?=

.PHONY: demo test check static kernels install install-docs install-test bench bench-check slow docs docs-figures answer clean

demo: install
	$(BIN)/slamcmp run experiments/victoria_park.yaml

test: install-test
	$(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

check: install-test
	$(MAKE) --no-print-directory -j2 static kernels
	$(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

static:
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Once, on the core that the checkers leave free: each of pytest's workers would compile for itself.
kernels:
	$(BIN)/python -c 'from slamcmp.backends.filters.loops import kernels; kernels()'

slow: install-test
	$(BIN)/python -m pytest -m slow -n 2 $(PYTEST_ARGS)

# All of them, whatever the others say; the table goes to benchmarks/results/.
bench: install-test
	$(BIN)/python benchmarks/all.py

bench-check: install-test
	$(BIN)/python benchmarks/all.py --check

# The site, into build/docs; a warning is an error, and nothing is fetched but the packages.
docs: install-docs
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs
	@echo "build/docs/index.html"

docs-figures: install
	$(BIN)/python docs/make_figures.py

answer: install-test
	for part in $(basename $(notdir $(wildcard experiments/answer/*.yaml))); do \
	  $(BIN)/slamcmp run answer/$$part --results results/answer/$$part --no-report || [ $$? -eq 1 ] || exit; \
	done
	$(BIN)/python -m tests.anchors.answer results/answer
	$(BIN)/python docs/make_figures.py $(patsubst docs/images/%,%,$(wildcard docs/images/answer_*.png))

install: $(VENV)/.installed
install-docs: $(VENV)/.installed-docs
install-test: $(VENV)/.installed-test

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make demo PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --editable '.[fast]'
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(INSTALL) --editable '.[test,types,docs]'
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) --editable '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info
