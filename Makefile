# make demo     the whole chain once: simulate, play over DDS, calibrate, compare; writes demo_output/
# make test     every check and test
# make check    format, lint, types and prose only
# make bytecode what the tests import, compiled once: else each of their processes does it for itself
# make docs     the site of docs/ and the docstrings; writes build/docs/index.html
# make battery  every bad input and kill, and a flood of the nodes for a minute; a seed: make battery SEED=7
# make soak     twenty minutes of faults beside a run
# make mutants  whether a test fails when fit/, live/, localization/, core/ or gap/ is changed in one place: hours; a room or
#               module: make mutants OF=fit/ellipsoid; what has changed since a commit, in 45 s: make mutants SINCE=HEAD~10
# make bench    every figure of speed beside what it is compared with: a quarter of an hour; writes benchmarks/results/
# make count    modules, lines, functions and constants of each room; words; modules that tam calibrate enters
# make colcon   build and test as a ROS 2 machine does, in build/ and install/
# make clean    remove what these wrote, except the environment .venv
# Each sets up .venv by itself; another interpreter than python3: make test PYTHON=python3.12

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
MAKEFLAGS += --no-print-directory
unexport PYTHONDONTWRITEBYTECODE  # hundreds of processes of the tests would compile the package each for itself

.PHONY: demo test check bytecode docs battery soak mutants bench count colcon clean

demo: $(READY)
	@$(BIN)/tam demo

test: export OPENBLAS_NUM_THREADS := 1
test: export ROS_PYTHON_CHECK_FIELDS := 1
# Arrays that are freed stay with the process: else each new one of a megabyte is mapped anew, a twentieth of the time.
test: export MALLOC_MMAP_THRESHOLD_ := 268435456
test: export MALLOC_TRIM_THRESHOLD_ := 268435456
test: check
	@$(BIN)/pytest --numprocesses 3 --dist worksteal --hypothesis-profile ci

check: $(READY)
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/ruff check --quiet .
	@$(BIN)/mypy --no-error-summary --num-workers 2
	@$(BIN)/python benchmarks/prose.py

bytecode: $(READY)
	@$(BIN)/pytest --collect-only --quiet >/dev/null || true

docs: $(READY)
	@$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --fresh-env docs build/docs

battery soak: export PYTHONPATH := $(CURDIR)/test:$(CURDIR)
battery soak: export OPENBLAS_NUM_THREADS := 1

battery: $(READY)
	@FLOOD_S=60 $(BIN)/pytest --quiet test/nodes/test_flood.py
	@$(BIN)/python -m battery $(if $(SEED),--seed $(SEED))

soak: $(READY)
	@SOAK_S=1200 $(BIN)/pytest --quiet --capture no test/battery/test_soak.py

mutants: export OPENBLAS_NUM_THREADS := 1
mutants: $(READY)
	@if $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[mutants]'; \
	then nice $(BIN)/python benchmarks/mutants.py $(if $(SINCE),--since $(SINCE),$(OF)); \
	else echo "Mutants are left out: cosmic-ray cannot be installed"; fi

bench: $(READY)
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[bench]' \
		|| echo "The fits of other packages cannot be installed and are left out"
	@$(BIN)/python benchmarks/run_all.py

count: $(READY)
	@$(BIN)/python benchmarks/count.py

colcon: $(READY)
	@PATH="$(CURDIR)/$(BIN):$$PATH"; colcon build && colcon test && colcon test-result

$(READY): setup.py setup.cfg pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "tam_calibration needs Python 3.11 or newer, \
	and $(PYTHON) is %d.%d: name another one, as in make PYTHON=python3.12" % sys.version_info[:2])'
	@echo "Setting up .venv with $(PYTHON): this takes a minute or two, once"
	@$(PYTHON) -m venv .venv
	@$(BIN)/pip install -qq --disable-pip-version-check --no-compile --constraint constraints.txt --upgrade pip \
		|| true  # that of Python 3.11 resolves some two hundred packages in twice the time
	@$(BIN)/pip install -qq --disable-pip-version-check --no-compile --constraint constraints.txt \
		--editable '.[ros,test]'
	@echo "$(CURDIR)" > "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/tam_validation.pth"
	@touch $@

clean:
	rm -rf build install log demo_output *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find tam_calibration tam_validation benchmarks docs examples test launch -name __pycache__ -prune -exec rm -rf {} +
