PYTHON ?= python3
VENV := .venv
STAMP := $(VENV)/.installed
BIN := $(VENV)/bin

.PHONY: run test check format mutants faults fuzz clean help

help:  ## Show the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Roomfix needs Python 3.11 or later; set PYTHON=python3.x") if sys.version_info < (3, 11) else None'
	test -d $(VENV) || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[bench,dev,faces,postgresql,scans,sfm,surf]'
	touch $(STAMP)

run: $(STAMP)  ## Build the demonstration venue, serve it on 127.0.0.1:8000, and phones by https with a QR code
	$(BIN)/roomfix demo --phones

test: $(STAMP)  ## Run the whole test suite
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

check: $(STAMP)  ## Lint, format check, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)  ## Format and fix
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

mutants: $(STAMP)  ## Change the code that refuses wrong answers, and list the changes that no test notices (about an hour)
	$(BIN)/python -m bench.mutation --figures

FAULTS ?= 200

faults: $(STAMP)  ## Kill, damage and fill disks on purpose, 200 times each (more than an hour; FAULTS=20 for less)
	FAULTS=$(FAULTS) $(BIN)/python -m pytest tests/faults

FUZZ ?= 50

fuzz: $(STAMP)  ## Requests made from the OpenAPI document, FUZZ of them per call, kind of key and phase (minutes)
	FUZZ=$(FUZZ) $(BIN)/python -m pytest tests/fuzz

clean:  ## Remove the environment and the demonstration data
	rm -rf $(VENV) .roomfix
