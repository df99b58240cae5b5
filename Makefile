# Everything is installed into .venv. Stamp files in it tell what is up to date, so a second call
# does nothing, and needs no network.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALL := $(PIP) install --quiet --constraint requirements/constraints.txt
# RotorPy is here without what it asks for and does not import (requirements/examples.txt).
CONSISTENT := ! $(PIP) check | grep -v -e '^No broken requirements' -e '^rotorpy '
PACKAGES := feed_axis_common mpc_controller milling_plant bo_tuner tuning_benchmark
# With the folders, so that a deleted file counts as a change too.
SOURCES := $(shell find $(PACKAGES:%=ros2_ws/src/%) \
	\( -name __pycache__ -o -name '*.egg-info' -o -name build \) -prune -o -print)
SOURCE_PATH := $(subst $() ,:,$(PACKAGES:%=ros2_ws/src/%))

# A sourced ROS installation must not shadow what is in .venv.
unexport PYTHONPATH PYTHONHOME
# Container images set it; without a cache each test process compiles all test modules anew.
unexport PYTHONDONTWRITEBYTECODE
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp
# Set by the ROS wheels of the environment that called us; with it, ours would load its libraries.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif
# Nodes of the checks talk to each other only, and leave no shared memory behind.
CHECK_ENV := ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET FASTDDS_BUILTIN_TRANSPORTS=UDPv4 \
	FASTRTPS_DEFAULT_PROFILES_FILE='$(CURDIR)/ros2_ws/src/bo_tuner/config/fastdds_profile.xml' \
	ROS_LOG_DIR='$(CURDIR)/$(VENV)/log' ROS_PYTHON_CHECK_FIELDS=1

# Processes of the benchmark and of the tests.
JOBS ?= $(shell nproc 2>/dev/null || echo 1)
# Tests wait for nodes and browsers for more than half of their time.
TESTERS ?= $(shell expr 2 \* $(JOBS))
EXPERIMENTS ?= paper peers choices boundary promise closed_form risk

.PHONY: help setup tune quadrotor cessna benchmark test lint types format check colcon clean
.NOTPARALLEL:

help:
	@echo 'make setup      install ROS 2 and the packages into $(VENV) (PYTHON=python3.12 picks one)'
	@echo 'make tune       tune the feed axis (ARGS="--trials 20" and so on)'
	@echo 'make quadrotor  tune a quadrotor in wind: RotorPy and its controller (docs/examples.md)'
	@echo 'make cessna     tune a Cessna 172: JSBSim and its autopilot (docs/examples.md)'
	@echo 'make test       run the test suite (ARGS="-k kalman" and so on)'
	@echo 'make benchmark  make docs/results.md: tables and figures of the paper, other optimizers'
	@echo 'make check      lint, types and tests'
	@echo 'make lint       ruff and import-linter'
	@echo 'make types      mypy'
	@echo 'make format     reformat the code'
	@echo 'make colcon     install colcon into $(VENV)'
	@echo 'make clean      remove all of it, but not runs/'

setup: $(VENV)/.packages

tune: setup
	$(BIN)/tune $(ARGS)

# Tune, certify, and compare with the default and a classical rule on a dense grid of conditions.
quadrotor cessna: setup $(VENV)/.examples
	$(BIN)/python examples/campaign.py $@ $(ARGS)

benchmark: setup $(VENV)/.benchmarks
	$(BIN)/benchmark $(EXPERIMENTS:%=--experiment %) \
		--output docs --records benchmarks/results --jobs $(JOBS) $(ARGS)

test: setup $(VENV)/.dev $(VENV)/.examples
	$(CHECK_ENV) $(BIN)/python -m pytest --numprocesses $(TESTERS) --dist worksteal $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PYTHONPATH=$(SOURCE_PATH) $(BIN)/lint-imports

types: $(VENV)/.dev
	$(BIN)/mypy
	$(BIN)/mypy --config-file benchmarks/mypy.ini

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

check: lint types test

colcon: $(VENV)/.colcon

clean:
	rm -rf $(VENV) ros2_ws/build ros2_ws/install ros2_ws/log
	rm -rf .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache .coverage

$(VENV)/.created:
	@command -v '$(PYTHON)' >/dev/null || { echo 'error: $(PYTHON) not found;' \
		'install Python 3.11, 3.12 or 3.13, or name one: make PYTHON=python3.12' >&2; exit 1; }
	@'$(PYTHON)' -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || { \
		echo "error: $$('$(PYTHON)' -V 2>&1) is not Python 3.11, 3.12 or 3.13;" \
		'name one: make PYTHON=python3.12' >&2; exit 1; }
	@'$(PYTHON)' -c 'import ensurepip, venv' 2>/dev/null || { \
		echo 'error: $(PYTHON) cannot make virtual environments;' \
		'on Debian and Ubuntu: apt install python3-venv' >&2; exit 1; }
	'$(PYTHON)' -m venv $(VENV)
	@touch $@

$(VENV)/.runtime: requirements/runtime.txt requirements/constraints.txt $(VENV)/.created
	@echo 'installing ROS 2 and the numerics into $(VENV)'
	$(INSTALL) --requirement requirements/runtime.txt
	@$(CONSISTENT)
	@$(CHECK_ENV) $(BIN)/python -c 'import rclpy; rclpy.init(); rclpy.create_node("setup")' || { \
		echo 'error: the ROS packages in $(VENV) cannot create a node; try make clean setup' >&2; \
		exit 1; }
	@touch $@

# Built from a copy: a build leaves folders in its source tree, from which deleted modules return.
$(VENV)/.packages: $(SOURCES) $(VENV)/.runtime
	@rm -rf $(VENV)/build && mkdir $(VENV)/build
	@cp -R $(PACKAGES:%=ros2_ws/src/%) $(VENV)/build
	@cd $(VENV)/build && rm -rf */build */*.egg-info
	SOURCE_COMMIT="$$(git describe --always --dirty --abbrev=12 --exclude='*' 2>/dev/null)" \
	$(INSTALL) --no-index --no-deps --no-build-isolation --use-pep517 --force-reinstall \
		$(PACKAGES:%=./$(VENV)/build/%)
	@rm -rf $(VENV)/build
	@$(CONSISTENT)
	@touch $@

$(VENV)/.dev $(VENV)/.colcon $(VENV)/.benchmarks: $(VENV)/.%: requirements/%.txt requirements/constraints.txt $(VENV)/.runtime
	$(INSTALL) --requirement $<
	@$(CONSISTENT)
	@touch $@

$(VENV)/.examples: requirements/examples.txt requirements/constraints.txt $(VENV)/.runtime
	$(INSTALL) --no-deps --requirement $<
	@$(CONSISTENT)
	@touch $@
