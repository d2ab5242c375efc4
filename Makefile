# Every target prepares what it needs: a virtual environment and the pinned packages. Python 3.10 or later and make suffice.
PYTHON ?= python3
VENV ?= .venv
# Processes that run the test suite.
JOBS ?= 2
# Further arguments for train.py, pytest or the study, for example: make train ARGS="--env Taxi-v4 --method 3"
ARGS ?=
# Tests that work without the compiler.
PLAIN := tests/test_step_sizes_golden.py tests/test_algorithms_golden.py tests/test_step_sizes.py \
	tests/test_algorithms_behaviour.py
# Where training leaves its TensorBoard log.
LOG ?= runs

BIN := $(VENV)/bin
ZOO := $(VENV)/.installed-zoo
DEV := $(VENV)/.installed-dev
REQUIREMENTS := pyproject.toml constraints.txt

# $(call install,EXTRAS): the package itself (editable) with the named extras, at the pinned versions. A dot every few
# seconds shows that it is alive: pip's own progress is either silent or hundreds of lines.
define install
@printf 'Installing sb3-adaptive-q[%s] into $(VENV) (PyTorch is large: the first time takes some minutes) ' '$(1)'
@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[$(1)]' & pid=$$!; \
	trap 'kill $$pid' INT TERM; \
	while kill -0 $$pid 2>/dev/null; do printf '.'; sleep 2; done; \
	echo; wait $$pid
endef

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help train test fuzz endurance coverage mutate exhaustive boundscheck lint types docs benchmark study tensorboard wheel clean

help:  ## List the targets
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | awk -F '\t' '{ printf "  make %-12s %s\n", $$1, $$2 }'

train: $(ZOO)  ## Train FrozenLake-v1 for 500 000 steps with Method 1
	$(BIN)/python train.py --algo tabular_q --env FrozenLake-v1 --method 1 -n 500000 -P -tb $(LOG) $(ARGS)

test: $(DEV)  ## Run the test suite
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(ARGS)

fuzz: $(DEV)  ## Try 5 000 random decision processes on both paths
	FUZZ_CASES=5000 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/test_random_mdps.py $(ARGS)

endurance: $(DEV)  ## Fifty kills, ten thousand million transitions, trainings side by side (about half an hour)
	EXHAUSTIVE=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/endurance/*.py tests/test_resume.py::TestKilled $(ARGS)

# Lines of functions that become machine code are seen where Python runs them, without the compiler. A signal's handler that
# raises may leave the lock of coverage.py taken for ever, so the tests of such handlers are left out.
coverage: $(DEV)  ## Run the test suite, and tell the lines that it does not reach
	$(BIN)/coverage erase
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run -m pytest -k "not compiled and not (test_algorithms_behaviour and True)" $(PLAIN)
	$(BIN)/coverage run -m pytest -n $(JOBS) --dist worksteal --ignore tests/test_interrupts.py $(ARGS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

mutate: $(DEV)  ## Change the equations one by one, and tell the changes that no test finds (see tests/mutants.md)
	NUMBA_DISABLE_JIT=1 $(BIN)/mutmut run --max-children $(JOBS) $(ARGS)
	$(BIN)/mutmut results

exhaustive: $(DEV)  ## Run what the test suite has samples of, whole: all pairs of choices, 400 interrupts
	EXHAUSTIVE=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/test_algorithms_paths.py tests/test_interrupts.py $(ARGS)

# In a cache of its own, which is empty at first: machine code with checks is other machine code.
boundscheck: $(DEV)  ## Run the tests of machine code with every index checked
	cache=$$(mktemp -d) && trap 'rm -rf "$$cache"' EXIT && NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR="$$cache" \
		$(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/test_same_results.py tests/test_compiled_env.py \
		tests/test_compiled_callbacks.py tests/test_interrupts.py tests/test_algorithms_paths.py tests/test_transition_tables.py \
		tests/test_sizes.py $(ARGS)

lint: $(DEV)  ## Check style and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV)  ## Check types
	$(BIN)/mypy

docs: $(DEV)  ## Build the documentation into build/docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -d build/doctrees docs build/docs

benchmark: $(DEV)  ## Compare speeds, as ratios within one run
	$(BIN)/python -m benchmarks $(ARGS)

study: $(DEV)  ## Repeat the paper's experiment: tables, figures and report
	$(BIN)/python -m sb3_adaptive_q study $(ARGS)

tensorboard: $(ZOO)  ## Show the training log in the browser
	$(BIN)/tensorboard --logdir $(LOG)

wheel: $(DEV)  ## Build the wheel and the source distribution into dist/
	$(BIN)/python -m build

clean:  ## Remove the virtual environment and all that was built or cached
	rm -rf $(VENV) build dist docs/generated *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find sb3_adaptive_q wrappers tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "Python 3.10 or later is needed, $(PYTHON) is not: name another one with  make PYTHON=/path/to/python3"; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip>=23.1'
	@touch $@

$(ZOO): $(VENV)/.created $(REQUIREMENTS)
	$(call install,zoo)
	@touch $@

$(DEV): $(VENV)/.created $(REQUIREMENTS)
	$(call install,dev)
	@touch $(ZOO) $@
