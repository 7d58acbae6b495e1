# make graphene: everything from a fresh clone to the report of the main job, and nothing more.
# make test:     what the tests need beside it, then the suite, a file of tests to a core at a time.
# make slow:     what the suite leaves out for its time: long pages and fits.
# make verify:   known problems against their references; 1 where a row surprises.
# make docs:     the pages in docs/ as a site, in site/, and how they read in numbers.
PYTHON ?= python3
VENV   ?= .venv
BIN     = $(VENV)/bin

.PHONY: graphene test slow verify lint docs clean

graphene: $(VENV)/.main
	$(BIN)/python examples/train_graphene.py

test: $(VENV)/.installed
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

slow: $(VENV)/.installed
	$(BIN)/python -m pytest -m slow

verify: $(VENV)/.installed
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.known_problems

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python docs/check.py

docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[docs]' --constraint constraints.txt
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(BIN)/python docs/check.py

$(VENV)/.main: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; name one with make PYTHON=python3.x")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable . scikit-fem --constraint constraints.txt
	touch $@

$(VENV)/.installed: $(VENV)/.main
	$(BIN)/python -m pip install --quiet --editable '.[dev]' --constraint constraints.txt
	touch $@

clean:
	rm -rf $(VENV) build dist site *.egg-info
