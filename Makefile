# Every target sets up first what it needs; a set-up that is current costs a fraction of a second.
.DEFAULT_GOAL := help
.PHONY: help setup setup-training setup-sweep setup-all setup-checks build ride lap race live test test-long check docs \
	figures measure release format bench clean distclean

BIN := .venv/bin
SHELL_SCRIPTS := tools/setup tools/update-constraints tools/release .ci/run
YAML_FOLDERS := ros_ws/src docker .github .pre-commit-config.yaml mkdocs.yml CITATION.cff
MKDOCS := NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
# Tests run in as many processes as there are processors, at most four; those of a file together, since they share
# fixtures that take seconds, in pytest's order.
SIDE_BY_SIDE := -n logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## What riding, recording and analysis need: system packages, .venv, colcon workspace, compiled kernels
	@tools/setup

setup-training: ## The learning packages as well: PyTorch, JAX and what stands on them
	@tools/setup training

setup-sweep: ## And those of sweeps: Ray
	@tools/setup sweep

setup-all: ## All of it, and what tests, checks and benchmarks need
	@tools/setup all

setup-checks:
	@tools/setup checks

build: setup ## Build the colcon workspace, also when it is current
	@tools/setup build

ride: setup ## Ride the benchmark path with the shipped actor and write ride.mcap and a report
	@$(BIN)/bike ride

lap: setup ## Barcelona through the nodes: the default rider, the classical one and the best lap found: out/lap/ride.html
	@$(BIN)/bike ride --course barcelona --nodes --beside classical optimum

race: setup ## Four superbikes race two laps of Barcelona: recording, table and out/race/race.html
	@$(BIN)/bike race

live: setup ## A ride in the browser: watch it, or ride yourself (V=panigale_v4r for a superbike)
	@$(BIN)/bike live --vehicle $(or $(V),whipple)

test: setup-all ## Run the tests, long ones first; Chromium is installed for those of the report page
	@tools/setup browser
	$(BIN)/python -m pytest $(SIDE_BY_SIDE)

test-long: setup-all ## The tests that take minutes, or download, and the quick ones with examples drawn anew
	@tools/setup browser
	$(BIN)/python -m pytest -m long
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) --hypothesis-profile=explore -m 'not long and not slow and not ros'

check: setup-checks ## Style, types, import rules, shell scripts, Dockerfiles, YAML, the documents' site
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy tools
	$(BIN)/lint-imports
	$(BIN)/shellcheck $(SHELL_SCRIPTS)
	$(BIN)/hadolint docker/Dockerfile docker/Dockerfile.jazzy
	$(BIN)/yamllint --strict $(YAML_FOLDERS)
	$(MKDOCS)

docs: setup-checks ## Build the documents' site into out/site
	$(MKDOCS)

figures: setup-all ## Fill the tables of documents from data files and from the code; measures nothing
	$(BIN)/python tools/figures.py

measure: setup-all ## Make the data of those tables anew that are older than the code: all that take no more than an hour
	$(BIN)/python tools/measure.py $(CLASS) $(if $(ONLY),--only $(ONLY))

release: setup-checks ## Build wheel and sdist into out/dist, check them, and ride from the wheel in a clean environment
	@tools/release

format: setup-checks ## Apply the formatter and the fixes that are safe
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup-all ## Measure speeds and compare them
	@$(BIN)/bike bench

clean: ## Remove caches and what a plain `colcon build` left; .venv stays
	rm -rf ros_ws/build ros_ws/install ros_ws/log .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find analysis bench ros_ws tests tools training -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## Remove .venv as well, and with it the built workspace
	rm -rf .venv
