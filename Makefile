# `make run` and `make test` set everything up by themselves; they need python3 (3.11 or newer, with venv), make and git.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
RUN_READY := $(VENV)/.ready-run
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

OUT ?= runs/reproduce
SWEEP ?= sweeps/gamma.toml
TIMES ?= $(OUT)/times.json
NEW ?= docs/benchmarks.json
KILLS ?= 500
# docs/results/curiosity.md has 200; so many take half an hour and leave less decided.
SEEDS ?= 100
MINUTES ?= 10

.PHONY: help setup run reproduce sweep study docs test test-slow test-long test-ray test-cluster test-cluster-short test-archive test-sb3 test-kill versions fuzz lint format types check bench bench-check bench-cluster lock clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# Running needs a gigabyte, testing and the documentation twice that: `make run` installs the first part alone.
$(RUN_READY): requirements-run.lock pyproject.toml
	$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(INSTALL) --require-hashes -r requirements-run.lock
	$(INSTALL) --no-deps --no-build-isolation -e .
	touch $@

$(READY): requirements.lock $(RUN_READY)
	$(INSTALL) --require-hashes -r requirements.lock
	touch $@

setup: $(READY) ## make the environment in .venv from the locked versions

run: $(RUN_READY) ## the paper's first experiment: three algorithms, 20 seeds, planar2; figures and verdicts
	$(BIN)/icac reproduce --arm planar2 --no-ablations

reproduce: $(RUN_READY) ## the paper's whole evaluation, both arms; called again it goes on where it stopped
	$(BIN)/icac reproduce --out $(OUT)

sweep: $(RUN_READY) ## train every cell of SWEEP (sweeps/gamma.toml), into a new folder under runs/
	$(BIN)/icac sweep $(SWEEP)

study: $(RUN_READY) ## where curiosity pays, SEEDS=100 per cell, four tasks, into runs/; goes on where it stopped
	$(BIN)/icac sweep curiosity --seeds $(SEEDS) --out runs/curiosity
	$(BIN)/icac sweep curiosity_gate --seeds $(SEEDS) --out runs/curiosity_gate

docs: $(READY) ## build the documentation into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

test: $(READY) ## run the tests
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

test-slow: $(READY) ## run the full-size checks as well
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder -m ""

test-long: $(READY) ## what `make test` has a shorter version of: all kills and crashes, the long references, the locked wheel
	$(BIN)/python -m pytest --numprocesses auto -m slow tests/test_resume.py tests/test_reference.py tests/test_package.py \
	  tests/test_cacla.py tests/test_jax_settings.py::test_the_pure_functions_work_under_all_of_them

test-ray: $(READY) ## a sweep on a local Ray cluster, with a worker killed in the middle
	$(BIN)/python -m pytest -m slow tests/test_ray.py

test-cluster: $(READY) ## plain hosts, Slurm, Ray in network namespaces, under kills (root; Debian: iproute2, slurm-wlm, munge)
	$(BIN)/python -m tests.cluster $(KIND)

test-cluster-short: $(READY) ## one kill on each kind of cluster that can be started here
	$(BIN)/python -m tests.cluster --short

bench-cluster: $(READY) ## what a second node brings and what a task costs, on the same clusters
	$(BIN)/python -m tests.cluster.efficiency $(KIND)

test-archive: $(READY) ## every run in the archive of version 0.1.0, to the bit
	$(BIN)/python -m pytest --numprocesses auto -m slow tests/test_archive.py

test-sb3: $(READY) ## Stable-Baselines3 on the arms, in an environment of its own in .venv-sb3 (torch: gigabytes)
	$(PYTHON) -m venv .venv-sb3
	.venv-sb3/bin/python -m pip install --quiet -e '.[gymnasium,video]' -r examples/sb3_her/requirements.txt pytest hypothesis
	.venv-sb3/bin/python -m pytest -m slow tests/test_sb3.py

versions: $(READY) ## a canary of the tests with the oldest and newest versions allowed (needs uv, Python 3.11 to 3.13)
	$(BIN)/python -m tests.versions

test-kill: $(READY) ## KILLS=500 kills of train, resume, sweep, reproduce, evaluate at random moments, compared (hours)
	$(BIN)/python -m tests.kill $(KILLS)

fuzz: $(READY) ## feed damaged files to every command for MINUTES=10 with fresh seeds
	$(BIN)/python -m tests.fuzz $(MINUTES)

lint: $(READY) ## ruff, its formatter in check mode
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY) ## type checker
	$(BIN)/basedpyright

format: $(READY) ## rewrite the sources in the project's format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

check: lint types test ## all that must pass before a commit

bench: $(READY) ## the goals of speed, measured, into docs/benchmarks.md and .json (under 10 minutes); TIMES for G6
	$(BIN)/python -m tests.bench $(if $(wildcard $(TIMES)),--times $(TIMES))

bench-check: $(READY) ## what became slower from one benchmarks.json, OLD, to another, NEW
	$(BIN)/python -m tests.bench_check $(OLD) $(NEW)

LOCK := uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet

lock: ## take newer versions into the two locks (needs uv)
	$(LOCK) --upgrade --group dev pyproject.toml --output-file requirements.lock
	$(LOCK) --upgrade --group run --constraint requirements.lock pyproject.toml --output-file requirements-run.lock

clean: ## remove the environment and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build dist site
