# Everything is installed into .venv, for another ROS distribution into .venv-NAME. Stamp files in it tell what is up to date, so a second call
# does nothing, and needs no network.

PYTHON ?= python3
# ROS 2 distribution: jazzy or kilted.
DISTRO ?= jazzy
VENV := .venv$(if $(filter-out jazzy,$(DISTRO)),-$(DISTRO))
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
CONSTRAINTS := requirements/constraints.txt requirements/$(DISTRO)/constraints.txt
INSTALL := $(PIP) install --quiet $(CONSTRAINTS:%=--constraint %)
# RotorPy is here without what it asks for and does not import (requirements/examples.txt).
CONSISTENT := ! $(PIP) check | grep -v -e '^No broken requirements' -e '^rotorpy '
PACKAGES := feed_axis_common mpc_controller milling_plant bo_tuner tuning_benchmark
# With the folders, so that a deleted file counts as a change too.
PACKAGE_FILES := $(shell find $(PACKAGES:%=ros2_ws/src/%) \
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
# Up to Fast DDS 2 (Jazzy), and from 3 (Kilted) on.
PROFILE_VARIABLE := $(if $(filter jazzy,$(DISTRO)),FASTRTPS,FASTDDS)_DEFAULT_PROFILES_FILE
# Nodes of the checks talk to each other only, and leave no shared memory behind.
CHECK_ENV := ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET FASTDDS_BUILTIN_TRANSPORTS=UDPv4 \
	$(PROFILE_VARIABLE)='$(CURDIR)/ros2_ws/src/bo_tuner/config/fastdds_profile.xml' \
	ROS_LOG_DIR='$(CURDIR)/$(VENV)/log' ROS_PYTHON_CHECK_FIELDS=1

# Processes of the benchmark and of the tests.
JOBS ?= $(shell nproc 2>/dev/null || echo 1)
# Tests wait for nodes and browsers for more than half of their time.
TESTERS ?= $(shell expr 2 \* $(JOBS))
EXPERIMENTS ?= paper peers choices boundary promise closed_form risk

.PHONY: help setup interfaces workspace tune quadrotor cessna benchmark performance site dist test test-all lint \
	types format check colcon clean
.NOTPARALLEL:

help:
	@echo 'make setup      install ROS 2 and the packages into $(VENV) (PYTHON=python3.12, DISTRO=kilted)'
	@echo 'make interfaces build the interface packages in a folder into $(VENV) (INTERFACES=~/my_ws/src)'
	@echo 'make workspace  the same of any packages, also in C++ (SOURCES=~/my_ws/src)'
	@echo 'make tune       tune the feed axis (ARGS="--trials 20" and so on)'
	@echo 'make quadrotor  tune a quadrotor in wind: RotorPy and its controller (docs/examples.md)'
	@echo 'make cessna     tune a Cessna 172: JSBSim and its autopilot (docs/examples.md)'
	@echo 'make test       run the tests but the slow ones (ARGS="-k kalman" and so on; a path in it: all of that)'
	@echo 'make test-all   run all tests'
	@echo 'make benchmark  make docs/results.md: tables and figures of the paper, other optimizers'
	@echo 'make performance  make docs/performance.md, after scripts of benchmarks/ that ARGS names'
	@echo 'make site       the documents as a site in $(VENV)/site, with search and Python reference'
	@echo 'make dist       wheels and source distributions in dist/, checked'
	@echo 'make check      lint, types and make test'
	@echo 'make lint       ruff and import-linter'
	@echo 'make types      mypy'
	@echo 'make format     reformat the code'
	@echo 'make colcon     install colcon into $(VENV)'
	@echo 'make clean      remove all of it, but not runs/'

setup: $(VENV)/.packages

# Packages of messages, or of C++ nodes as well; with the folder of the one or the other.
FOLDER = $(if $(filter workspace,$@),$(SOURCES),$(INTERFACES))
# The wheels' libraries ask for symbols of Python, and of libraries that lie in folders of their own.
PROGRAM_FLAGS = -Wl,--unresolved-symbols=ignore-in-shared-libs -Wl,--disable-new-dtags \
	$(shell $(BIN)/python requirements/program_libraries.py)
interfaces workspace: setup $(VENV)/.colcon $(VENV)/.interfaces
	@test -d '$(FOLDER)' || { echo 'error: $(if $(filter workspace,$@),SOURCES,INTERFACES)=$(FOLDER) is not a' \
		'folder; name that of the packages: make $@' \
		'$(if $(filter workspace,$@),SOURCES,INTERFACES)=~/my_ws/src' >&2; exit 1; }
	@command -v cmake >/dev/null && command -v c++ >/dev/null || { echo 'error: CMake or a C++' \
		'compiler is not found; on Debian and Ubuntu: apt install cmake g++ python3-dev' >&2; exit 1; }
	@rm -rf $(VENV)/build
	$(BIN)/python requirements/repair_exports.py
	PATH='$(CURDIR)/$(BIN)':"$$PATH" AMENT_PREFIX_PATH='$(CURDIR)/$(VENV)' \
		CMAKE_PREFIX_PATH='$(CURDIR)/$(VENV)' $(BIN)/colcon --log-base $(VENV)/log/colcon build \
		--base-paths '$(FOLDER)' --build-base $(VENV)/build --install-base $(VENV) --merge-install \
		--cmake-args -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release \
		-DCMAKE_EXE_LINKER_FLAGS='$(PROGRAM_FLAGS)' -DCMAKE_INSTALL_RPATH_USE_LINK_PATH=ON
	@rm -rf $(VENV)/build

tune: setup
	$(BIN)/tune $(ARGS)

# Tune, certify, and compare with the default and a classical rule on a dense grid of conditions.
quadrotor cessna: setup $(VENV)/.examples
	$(BIN)/python examples/campaign.py $@ $(ARGS)

benchmark: setup $(VENV)/.benchmarks
	$(BIN)/benchmark $(EXPERIMENTS:%=--experiment %) \
		--output docs --records benchmarks/results --publish docs/records --jobs $(JOBS) $(ARGS)

performance: setup $(VENV)/.dev $(VENV)/.benchmarks
	$(CHECK_ENV) $(BIN)/python benchmarks/performance.py $(ARGS)

site: setup $(VENV)/.site-tools
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs $(VENV)/site
	@echo 'the site is $(VENV)/site/README.html'

# Each is built from its source distribution, so that this is known to be whole.
dist: $(VENV)/.dist-tools
	@rm -rf dist
	@for package in $(PACKAGES); do $(BIN)/python -m build --no-isolation --outdir dist ros2_ws/src/$$package >$(VENV)/dist.log 2>&1 \
		|| { tail -n 20 $(VENV)/dist.log >&2; exit 1; }; done
	$(BIN)/twine check --strict dist/*

test: setup $(VENV)/.dev $(VENV)/.examples
	$(CHECK_ENV) $(BIN)/python -m pytest --numprocesses $(TESTERS) --dist worksteal $(SLOW) $(ARGS)

test-all: SLOW := --slow
test-all: test

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
	rm -rf dist .venv .venv-* ros2_ws/build ros2_ws/install ros2_ws/log
	rm -rf .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache .coverage

$(VENV)/.created:
	@test -d 'requirements/$(DISTRO)' || { \
		echo 'error: DISTRO=$(DISTRO) is not jazzy or kilted' >&2; exit 1; }
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

$(VENV)/.runtime: requirements/runtime.txt requirements/$(DISTRO)/runtime.txt $(CONSTRAINTS) $(VENV)/.created
	@echo 'installing ROS 2 ($(DISTRO)) and the numerics into $(VENV)'
	$(INSTALL) --requirement requirements/runtime.txt --requirement requirements/$(DISTRO)/runtime.txt
	@$(CONSISTENT)
	@$(CHECK_ENV) $(BIN)/python -c 'import rclpy; rclpy.init(); rclpy.create_node("setup")' || { \
		echo 'error: the ROS packages in $(VENV) cannot create a node; try make clean setup' >&2; \
		exit 1; }
	@touch $@

# Built from a copy: a build leaves folders in its source tree, from which deleted modules return.
$(VENV)/.packages: $(PACKAGE_FILES) $(VENV)/.runtime
	@rm -rf $(VENV)/build && mkdir $(VENV)/build
	@cp -R $(PACKAGES:%=ros2_ws/src/%) $(VENV)/build
	@cd $(VENV)/build && rm -rf */build */*.egg-info
	SOURCE_COMMIT="$$(git describe --always --dirty --abbrev=12 --exclude='*' 2>/dev/null)" \
	$(INSTALL) --no-index --no-deps --no-build-isolation --use-pep517 --force-reinstall \
		$(PACKAGES:%=./$(VENV)/build/%)
	@rm -rf $(VENV)/build
	@$(CONSISTENT)
	@touch $@

$(VENV)/.dev: requirements/dev.txt requirements/$(DISTRO)/dev.txt $(CONSTRAINTS) $(VENV)/.runtime
	$(INSTALL) --requirement requirements/dev.txt --requirement requirements/$(DISTRO)/dev.txt
	@$(CONSISTENT)
	@touch $@

$(VENV)/.interfaces: requirements/$(DISTRO)/interfaces.txt $(CONSTRAINTS) $(VENV)/.runtime
	$(INSTALL) --requirement $<
	@$(CONSISTENT)
	@touch $@

$(VENV)/.site-tools $(VENV)/.dist-tools: $(VENV)/.%-tools: requirements/%.txt $(CONSTRAINTS) $(VENV)/.runtime
	$(INSTALL) --requirement $<
	@$(CONSISTENT)
	@touch $@

$(VENV)/.colcon $(VENV)/.benchmarks: $(VENV)/.%: requirements/%.txt $(CONSTRAINTS) $(VENV)/.runtime
	$(INSTALL) --requirement $<
	@$(CONSISTENT)
	@touch $@

$(VENV)/.examples: requirements/examples.txt $(CONSTRAINTS) $(VENV)/.runtime
	$(INSTALL) --no-deps --requirement $<
	@$(CONSISTENT)
	@touch $@
