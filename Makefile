# make help lists the targets. STACK=wheel or STACK=debian chooses where .venv has its complex PETSc from
# (docs/install.md). Another Python with a complex PETSc: make test PYTHON=python3
SHELL := /bin/bash
PYTHON = .venv/bin/python
SETUP := pyproject.toml $(wildcard tools/setup.sh tools/requirements.py tools/constraints-debian.txt)
# .venv is ours to make; any other Python is its owner's.
STAMP := .venv/.ready$(addprefix -,$(STACK))
READY := $(if $(filter .venv/bin/python,$(PYTHON)),$(STAMP))
READY_DOCS := $(if $(READY),.venv/.docs)
export PYTHON STACK

.PHONY: help setup demo figures test test-fast test-slow test-docs tutorials test-fresh coverage lint format docs bench bench-bounds \
    bench-scaling bench-lammps bench-shear bench-cuda clean
.DEFAULT_GOAL := help

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 20

setup: $(READY) ## install what is missing (.venv; STACK=debian: Debian's packages)

$(STAMP): $(SETUP)
	tools/setup.sh test dev
	@touch .venv/.ready $@

.venv/.docs: $(STAMP)
	tools/setup.sh docs
	@touch $@

demo: $(READY) ## prepare 1024 disks, compute G*(ω) on two ranks, draw it (folder demo/)
	mpi_runs/demo.sh

test: $(READY) ## all tests except the slow ones, on 1, 2 and 3 ranks
	tools/test.sh $(PYTHON) 'not slow'

test-fast: $(READY) ## only the serial ones of these
	RANKS=1 tools/test.sh $(PYTHON) 'not slow'

test-slow: $(READY) ## the slow tests
	LIMIT=14400 tools/test.sh $(PYTHON) slow

test-docs: $(READY) ## every command and block of Python in README.md and docs, in small sizes (ten minutes)
	$(PYTHON) -m pytest tests/test_documents.py

tutorials: $(READY) ## the tutorials in full size: their outputs and pictures, put into the pages (half an hour and more)
	$(PYTHON) tools/documents.py docs/tutorial/*.md

coverage: $(READY) ## coverage of the tests, as a table and in docs/_build/coverage (twice the time of make test)
	rm -f .coverage .coverage.*
	COVERAGE=1 tools/test.sh $(PYTHON) 'not slow'
	$(PYTHON) -m coverage combine -q
	$(PYTHON) -m coverage html -q
	$(PYTHON) -m coverage report

test-fresh: ## demo, lint and tests on bare Debian 12 and 13, both stacks (as root; an hour)
	tools/test-fresh.sh

lint: $(READY) ## ruff, ruff format, mypy
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	@if $(PYTHON) -c 'import numpy; raise SystemExit("2.0" <= numpy.__version__[:3] < "2.5")'; then echo mypy; $(PYTHON) -m mypy; \
	    else echo "mypy: left out, the types of NumPy 2.0 to 2.4 (Debian 13's) are too vague"; fi

format: $(READY) ## repair and format with ruff
	$(PYTHON) -m ruff check --fix
	$(PYTHON) -m ruff format

docs: $(READY_DOCS) ## HTML pages in docs/_build/html; a warning is an error
	rm -rf docs/_generated # pages of modules that are gone
	$(PYTHON) -m sphinx -q -E -W --keep-going -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

figures: $(READY) ## every figure of both papers (medium), and its page in the docs (an hour, and nine hours; resumable)
	mpi_runs/figures.sh medium
	mpi_runs/figures.sh medium vot
	$(PYTHON) tools/paper-pages.py runs/medium

bench: $(READY) ## spectrum and direct solves compared with bare MUMPS and SciPy, as ratios (six minutes; DISKS=4096 for less)
	mpi_runs/bench.sh

bench-bounds: $(READY) ## factorisations, error bounds and true errors of spectra of 52 packings, and AAA (seven minutes)
	mpi_runs/error_bounds.sh

bench-scaling: $(READY) ## strong and weak scaling of spectra on 1 and 2 ranks, with a figure (five minutes)
	. tools/mpi-env.sh && $(PYTHON) benchmarks/scaling.py -o docs/figures/scaling.png

bench-lammps: $(READY) ## minimisation compared with LAMMPS, in a separate environment (ten minutes)
	$(PYTHON) benchmarks/minimise_lammps.py

bench-shear: $(READY) ## steps per second of sheared disks compared with LAMMPS (ten minutes), and steady states
	$(PYTHON) benchmarks/shear_lammps.py
	$(PYTHON) benchmarks/shear_lammps.py --physics

bench-cuda: $(READY) ## sheared disks on this machine's GPU: agreement with the CPU, and steps per second (five minutes)
	$(PYTHON) benchmarks/shear_cuda.py

clean: ## remove all built and computed files, but not .venv
	rm -rf docs/_build docs/_generated build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests examples -name __pycache__ -prune -exec rm -rf {} +
