# make quickstart | make test | make install | make lint | make benchmark
# Another interpreter: make PYTHON=python3.12 test
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Processes that share the modules of the tests.
PROCESSES ?= 2
SOURCES := gensp conf tests benchmarks examples train.py

# One thread each: the tests and the item workers use processes.
ONE_THREAD := OMP_NUM_THREADS=1 IGL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: quickstart test install lint format benchmark clean

quickstart: install
	$(BIN)/python train.py experiment=quickstart

test: lint
	$(ONE_THREAD) $(BIN)/python -m pytest -n $(PROCESSES) --dist loadscope --no-loadscope-reorder

lint: install
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy

format: install
	$(BIN)/ruff check --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

benchmark: install
	$(ONE_THREAD) $(BIN)/python benchmarks/speed.py

install: $(VENV)/.installed

# torch is pinned in constraints.txt, so one call of pip picks the build of the configured index.
$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is required: make PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info
