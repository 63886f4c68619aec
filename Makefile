# Everything runs in .venv, which is made here from Python 3.11 or newer and the pins in constraints.txt.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# Test processes, for two cores: tests that wait (browsers, servers, limits of time) leave room for a third. A compiled
# simulation takes up to 1 GB while it is being compiled.
WORKERS ?= 3
# Where this is set (containers often do), every process that tests start compiles all modules anew: 5 s of 8 of a server.
unexport PYTHONDONTWRITEBYTECODE
# Files of tests that compile nothing and build no catalogue, for make quick.
QUICK := $(addprefix tests/, docs/test_docs_pages.py \
  $(addprefix solver/test_, fault.py fits.py iso286.py machine_file_page.py machine_refusals.py matrix.py units.py) \
  $(addprefix catalogue/test_, conformal.py csv.py import_profile.py log_sums.py metrics.py plan_refusals.py verdict.py) \
  $(addprefix app/test_, openapi.py paging.py problems.py settings.py words.py))
# Options of make bench.
BENCH ?=
PINS   := build/pins
PIN    := $(PINS)/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --no-header \
  --no-annotate
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
LOWEST := build/lowest
LOWEST_TESTS := $(addprefix tests/app/test_,$(addsuffix .py,api_keys cli gate http logs measurements_http prometheus \
    proxies reports settings webhooks)) \
  $(addprefix tests/catalogue/test_,$(addsuffix .py,export features gaussian readers store)) \
  $(addprefix tests/solver/test_,$(addsuffix .py,drawing machine native simulate spectrum))

.DEFAULT_GOAL := help
.PHONY: help install demo test long quick lint format unit docs lowest fuzz fuzz-readers schemathesis serve bench openapi pins
.PHONY: audit clean

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 16

demo: $(STAMP) ## simulate a worn machine, build a small catalogue, find the worn joint again
	$(BIN)/python -m jointplay.app.demo

install: $(STAMP) ## everything the command needs, into .venv

serve: $(STAMP) ## the web form and the HTTP API on http://127.0.0.1:8000
	$(BIN)/jointplay serve --no-keys

test: lint unit ## style, types, layers, and all tests but those of `make long`

long: $(STAMP) ## tests of ten seconds and more: journeys of users, random machines, kills, whole evaluations
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m long

quick: lint ## what fails most often, within a minute: style, types, layers, the fastest tests
	$(BIN)/pytest -q $(QUICK)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP) ## put the code into the form that the checks want
	$(BIN)/ruff check --fix --exit-zero .
	$(BIN)/ruff format .

unit: $(STAMP)
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m 'not long' --durations 30 --durations-min 5

docs: $(STAMP) ## the pages of docs/ as a site in build/docs; a link that leads nowhere is an error
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --nitpicky --quiet -b html docs build/docs

# On the oldest Python that is allowed, where it is there; files that meet each of the direct dependencies.
lowest: ## tests of the service, and some of the others, with the lowest versions that pyproject.toml allows
	rm -rf $(LOWEST)
	$$(command -v python3.11 || echo $(PYTHON)) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --editable '.[dev]'
	$(LOWEST)/bin/pytest -n $(WORKERS) --dist worksteal $(LOWEST_TESTS)

fuzz: $(STAMP) ## 2000 random machines against the oracle; endings are kept in build/fuzz.jsonl, the same command goes on
	PYTHONPATH=tests $(BIN)/python -m fuzz.campaign 2000 $(WORKERS)

schemathesis: $(STAMP) ## what the OpenAPI document allows and forbids, sent to a server over a small catalogue, every operation
	$(BIN)/jointplay build slider-crank --catalogue build/schemathesis/slider-crank --plan quick
	$(BIN)/python -m benchmarks.api_fuzz build/schemathesis

fuzz-readers: $(STAMP) ## 10 000 damaged recordings of all kinds: read as what they are, or refused in one line
	PYTHONPATH=tests $(BIN)/python -m fuzz.readers --count 10000

bench: $(STAMP) ## cost and accuracy beside other programs, onto docs/measured/benchmarks.md (BENCH="--quick": a smoke test)
	@$(INSTALL) --require-hashes --no-deps --requirement benchmarks/constraints.txt \
	  || echo 'the other programs could not all be installed: those missing are named in the table' >&2
	$(BIN)/python -m benchmarks $(BENCH)

openapi: $(STAMP) ## the OpenAPI document made anew, with what a service answers now; another one has another version
	PYTHONPATH=tests $(BIN)/python tests/app/make_openapi.py

# Of every file that the registry has of a version, for whatever platform; one that is not among them is not installed.
pins: ## make constraints.txt and benchmarks/constraints.txt anew from the newest versions that fit pyproject.toml
	$(PYTHON) -m venv $(PINS)
	$(PINS)/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(PIN) --extra dev --extra cluster --extra tables pyproject.toml --output-file constraints.txt
	$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["bench"])' \
	  | tr ' ' '\n' | $(PIN) --constraint constraints.txt --no-deps - --output-file benchmarks/constraints.txt

audit: $(STAMP) ## known weaknesses of the pinned versions, where the registry's list of them can be reached
	$(PYTHON) -m venv $(PINS)
	$(PINS)/bin/python -m pip install --quiet --disable-pip-version-check pip-audit
	$(PINS)/bin/pip-audit --require-hashes --disable-pip --requirement constraints.txt

clean: ## remove what was made: the environment, caches, builds
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The version file is read at installation, the pins decide what is installed: either makes the environment stale.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'jointplay needs Python 3.11 or newer; this is $(PYTHON). Say: make PYTHON=python3.12' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo '$(PYTHON) cannot make virtual environments; on Debian and Ubuntu: apt-get install python3-venv' >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes --no-deps --requirement constraints.txt
	$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@
