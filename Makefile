# Every target makes its own set-up from a clean clone: a virtual environment in .venv, once.
#   make demo TORCH_INDEX=https://download.pytorch.org/whl/cpu    a CPU build of torch
PYTHON      ?= python3
VENV        ?= .venv
TORCH_INDEX ?=
OUT         ?= out/demo
SAMPLES     ?= 32
WORKERS     ?= 2
TESTERS     ?= 2
BENCH       ?= corpus

BIN   := $(VENV)/bin
STAMP := $(VENV)/.installed
# Whole files go to one of TESTERS processes, so that what a file's tests share is made once.
TESTS := $(BIN)/python -m pytest -n $(TESTERS) --dist loadfile

# One process, one core: thread pools that fight cost more than they give.
export OMP_NUM_THREADS      := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS      := 1

.PHONY: help demo test check prove bench clean
.DELETE_ON_ERROR:

help:
	@echo "make demo    render $(SAMPLES) labelled hands into $(OUT), verify them, write a gallery"
	@echo "make test    the tests"
	@echo "make check   format, lint, types and the tests: what continuous integration runs"
	@echo "make prove   the promises that take minutes: wheel elsewhere, kill and resume, memory"
	@echo "make bench   one benchmark: BENCH=$(BENCH)"
	@echo "make clean   remove the environment and everything that was made"

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is too old: synthgen needs Python >= 3.11 (make PYTHON=python3.12 ...)"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) -c constraints.txt torch
	$(BIN)/python -m pip install -c constraints.txt -e ".[dev]"
	@touch $@

demo: $(STAMP)
	$(BIN)/synthgen generate hand_rgbd --out $(OUT) --samples $(SAMPLES) --workers $(WORKERS) --set corpus.shard_size=16
	$(BIN)/synthgen verify $(OUT)
	$(BIN)/synthgen preview $(OUT)

test: $(STAMP)
	$(TESTS)

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(TESTS)

prove: $(STAMP)
	$(BIN)/python -m pytest -m "prove or slow"

bench: $(STAMP)
	$(BIN)/synthgen bench $(BENCH)

clean:
	rm -rf $(VENV) out build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
