# `make demo` and `make test` need nothing but make and a Python from 3.12 on; the rest is installed into .venv.

VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-all lint types notebooks clean

demo: $(VENV)/.installed
	$(BIN)/naraha survey --out out/survey

# One process a core, each with one thread.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

test: $(VENV)/.installed-test
	$(PYTEST)

test-all: $(VENV)/.installed-test
	$(PYTEST) -m "slow or not slow" --hypothesis-profile=search

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# The checker cannot follow an editable install; it sees the package through a link to this folder.
types: $(VENV)/.installed-test
	mkdir -p $(VENV)/src && ln -sfn ../.. $(VENV)/src/naraha
	MYPYPATH=$(VENV)/src $(BIN)/mypy -p naraha.systems -p naraha.diagrams -p naraha.models

clean:
	rm -rf $(VENV) out build dist *.egg-info

# A Python that runs and is new enough: a name on the path may be a shim that only prints an error.
$(BIN)/python:
	@for candidate in python3.12 python3.13 python3.14 python3 $$HOME/.pyenv/versions/3.1[2-9]*/bin/python3; do \
	  if $$candidate -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1; then python=$$candidate; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "naraha needs Python 3.12 or newer: none of python3.12, python3.13, python3.14 and python3 is one that runs." >&2; exit 1; \
	fi; \
	echo "setting up $(VENV) with $$($$python --version)"; \
	$$python -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.installed-test: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	@touch $@ $(VENV)/.installed
