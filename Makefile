# `make quickstart` and `make test` need Python 3.11 or 3.12 and nothing else.
PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3)
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= outputs/quickstart
CACHE  ?= $(OUT)/cache
DATA   ?= imptc
SIZE   ?= small
RAW    ?= data
JOBS   ?= 2
TABLE  ?= crowdnav
DOCS   := .venv-docs
LIMIT  := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: help install quickstart test test-all results tables docs bench peers throughput profile lint lock faults audit sbom clean
help:            ## Show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

$(BIN)/.installed: requirements.lock requirements-cuda.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes --no-deps --requirement requirements.lock
	$(BIN)/python scripts/needs_cuda.py || \
		$(BIN)/python -m pip install --quiet --require-hashes --no-deps --requirement requirements-cuda.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

install: $(BIN)/.installed ## Create .venv with the locked dependencies

quickstart: install ## Sample, conversion, training, per-mode table: less than 10 minutes on two cores
	$(BIN)/python scripts/generate_sample.py out=$(OUT)/recordings seed=0
	$(BIN)/python scripts/convert.py data=imptc data.root=$(OUT)/recordings data.cache=$(OUT)/cache
	$(LIMIT) $(BIN)/python scripts/train.py experiment=quickstart data=imptc data.cache=$(OUT)/cache out=$(OUT)/run
	$(LIMIT) $(BIN)/python scripts/evaluate.py checkpoint=$(OUT)/run/checkpoints/best.ckpt data=imptc data.cache=$(OUT)/cache out=$(OUT)/report
	@cat $(OUT)/report/metrics.md
	@echo "Report: $(OUT)/report/metrics.md and the plots beside it."
	@echo "All of it as one page: $(BIN)/dmmv-report $(OUT)/run $(OUT)/report out=$(OUT)/page"
	@echo "What to do next, with data of your own or in closed loop: docs/README.md"

# by file: what a file prepares for its tests is then prepared once
test: install ## Fast tests
	$(LIMIT) $(BIN)/python -m pytest -n $(JOBS) --dist loadfile

test-all: install ## All tests that need no GPU, slow ones included
	CHECKED_CALLS=1000000000 $(LIMIT) $(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "not gpu"

results: install ## The paper's table; SIZE=small|full, RAW=folder with one folder of recordings per data set
	$(BIN)/python scripts/results.py size=$(SIZE) raw=$(RAW)

tables: install  ## A table of closed-loop drives; TABLE=crowdnav|paper|ablation|published|dense|robustness|recorded, JOBS=processes
	$(BIN)/python scripts/closed_loop_table.py table=$(TABLE) launcher.processes=$(JOBS)

$(DOCS)/.installed: requirements-docs.lock
	test -x $(DOCS)/bin/python || $(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -m pip install --quiet --require-hashes --no-deps --requirement requirements-docs.lock
	touch $@

docs: $(DOCS)/.installed ## The documentation as a site in outputs/site; a dead link fails
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/python -m mkdocs build --strict
	@echo "Site: outputs/site/index.html"

bench: install ## Benchmarks, a look in outputs/bench/small or SIZE=full in benchmarks/results: tells needs and times, resumes; make peers first
	$(BIN)/python benchmarks/run_all.py --size $(or $(SIZE),small) $(if $(PEERS),--peers $(PEERS)) $(if $(HPIPM),--hpipm $(HPIPM)) $(if $(DRY),--dry-run)

peers: install  ## Solvers to compare with, in an environment of their own, outputs/peers (1.3 GB); TRAJAX=, DIFFMPC= git checkouts
	$(BIN)/python benchmarks/build_peers.py outputs/peers $(if $(TRAJAX),--trajax $(TRAJAX)) $(if $(DIFFMPC),--diffmpc $(DIFFMPC))

throughput: install ## Windows/s of training and evaluation per model; CACHE=, DATA= converted recordings, PEER=name=checkout
	$(LIMIT) $(BIN)/python benchmarks/bench_throughput.py $(CACHE) --data $(DATA) $(if $(PEER),--peer $(PEER))

profile: install ## Parts, operations, floor and flame chart of one training step per model, in outputs/profile
	$(LIMIT) $(BIN)/python benchmarks/profile_step.py $(CACHE) outputs/profile --data $(DATA)

lint: install ## ruff, pyright, codespell
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/codespell

faults: install  ## Try every kind of fault, table in docs/results/faults.md
	$(LIMIT) $(BIN)/python -m benchmarks.faults > docs/results/faults.md.part
	mv docs/results/faults.md.part docs/results/faults.md

sbom: install    ## List of dependencies with licences: outputs/sbom.json (CycloneDX) and outputs/licences.md
	$(BIN)/python scripts/sbom.py outputs

audit:           ## Look up known vulnerabilities of the locked versions; needs the network
	sh scripts/audit.sh $(PYTHON)

lock:            ## Write requirements.lock anew from the ranges of pyproject.toml
	sh scripts/lock.sh $(PYTHON)

clean: ## Remove the environment and all outputs
	rm -rf $(VENV) $(DOCS) outputs build *.egg-info
