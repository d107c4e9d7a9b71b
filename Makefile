# Every target makes what it needs; `make demo` and `make test` work on a fresh clone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: env demo test tests test-variants test-scico lint browser results reproduce bench bench-race bench-twin bench-design bench-stitch bench-live bench-reading bench-default bench-draft bench-model bench-priors bench-odd bench-dataset bench-batch training-photographs weights examples screenshots fuzz kill attack clean

# deepinv without torchvision, whose build in the index does not load beside a torch without CUDA; its
# tests do without. The others are what it asks for beyond the tests' own.
BARE := deepinv einops natsort

env: $(STAMP)

# A pip of today takes half the time of the one that a Python brings. Nothing is compiled beforehand:
# most of what is installed is never imported, and the rest is compiled where it first is, and kept.
unexport PYTHONDONTWRITEBYTECODE
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "nolens needs Python 3.11 or newer; this is %s. Try: make $(or $(WANTED),$(MAKECMDGOALS)) PYTHON=python3.11" % sys.version.split()[0])'
	test -x $(BIN)/python || $(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt pip
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[test]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt --no-deps $(BARE)
	touch $@

demo: $(STAMP)
	$(BIN)/nolens demo

# The studio's page is tested in Debian's Chromium. CI installs it; elsewhere these tests are
# skipped where there is none.
browser:
	@if ! command -v chromium >/dev/null && test -n "$(CI)" && command -v apt-get >/dev/null; then \
	  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium >/dev/null \
	    || echo "chromium cannot be installed: the tests of the page are skipped"; \
	fi

# Lint needs one core for half a minute: the tests begin beside it.
test:
	$(MAKE) --no-print-directory -j2 env browser WANTED=test
	$(MAKE) --no-print-directory -j2 lint tests

# Those of the kernels first, beside lint: each worker would compile the passes for itself. The others
# by workers as tests/conftest.py counts them, each on one thread, who take a module after the other.
tests: $(STAMP)
	$(BIN)/pytest tests/kernels
	$(BIN)/pytest --ignore tests/kernels -n logical

# The tests where machines differ: in workers, in order, and in how their processors round.
test-variants: $(STAMP) browser
	ATEN_CPU_CAPABILITY=default MKL_CBWR=COMPATIBLE ONEDNN_MAX_CPU_ISA=SSE41 NUMBA_CPU_NAME=generic \
	  OPENBLAS_CORETYPE=Prescott GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F \
	  $(BIN)/pytest -n 1 --shuffle 1
	ATEN_CPU_CAPABILITY=avx2 MKL_CBWR=AVX2 NUMBA_CPU_NAME=haswell OPENBLAS_CORETYPE=Haswell \
	  $(BIN)/pytest -n 2 --shuffle 2
	$(BIN)/pytest -n 4 --shuffle 3

# The volume by scico, in two or three minutes: its environment is that of the benchmark, and gives its
# packages to the tests'. Both are of Python 3.11.
SCICO := .bench-venv/scico
test-scico: $(STAMP)
	PYTHONPATH=bench $(PYTHON) -c 'import pathlib, peer_env; peer_env.SCICO_PEER.ensure(pathlib.Path(".bench-venv"))'
	PYTHONPATH=$(SCICO)/lib/python3.11/site-packages $(BIN)/python -c 'import scico'
	PYTHONPATH=$(SCICO)/lib/python3.11/site-packages $(BIN)/pytest tests/solvers/test_stack_scico.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# Real data lie outside the repository: DATA=... names the folder that holds them.
DATA ?= ../shared/data
results: $(STAMP)
	$(BIN)/python bench/results.py --data $(DATA)
	$(BIN)/python bench/pairs.py --data $(DATA)

# About half an hour; goes on where it was stopped.
reproduce: $(STAMP)
	$(BIN)/nolens reproduce -o build/reproduce
	rm -rf docs/reproduction
	mkdir docs/reproduction
	cp build/reproduce/pictures/*.png docs/reproduction/
	sed 's#](pictures/#](reproduction/#' build/reproduce/reproduction.md > docs/reproduction.md

bench: $(STAMP)
	$(PYTHON) bench/run.py

# Three quarters of an hour, nearly all of it the peer's.
bench-race: $(STAMP)
	$(PYTHON) bench/race.py

bench-twin: $(STAMP)
	$(BIN)/python bench/twin.py

# Some minutes: 1 000 items by one process, by three, and killed twice.
bench-dataset: $(STAMP)
	$(BIN)/python bench/dataset.py

bench-design: $(STAMP)
	$(BIN)/python bench/design.py

bench-stitch: $(STAMP)
	$(BIN)/python bench/stitch.py

# The default's pictures against the best of a grid, over simulated cameras: about an hour; then of
# real measurements, where they are: half an hour. Goes on where it was stopped.
bench-default: $(STAMP)
	$(BIN)/python bench/default.py --data $(DATA)

# Drafts of the same simulated measurements beside photographs: a quarter of an hour.
bench-draft: $(STAMP)
	$(BIN)/python bench/draft.py

# PSFs at several field points against one, in quality and cost: about half an hour.
bench-model: $(STAMP)
	$(BIN)/python bench/model.py
	$(BIN)/python bench/volume.py
	$(BIN)/python bench/video.py
	$(BIN)/python bench/bands.py

# Trained priors against total variation: some hours on one core; goes on where it was stopped.
# Downloads 170 MB of photographs in Debian's packages (apt-get download) into build/photographs,
# and a peer into .bench-venv.
bench-priors: $(STAMP)
	$(BIN)/python bench/priors.py --fetch --unseen --charts
	$(BIN)/python bench/priors_peer.py

# What is said of wrong and odd files, and falsely of good ones: about 20 minutes.
bench-odd: $(STAMP)
	mkdir -p build
	$(BIN)/python bench/alarms.py --data $(DATA) > build/alarms.txt
	$(BIN)/python bench/odd_inputs.py

# Memory and time of every reader at its limit.
bench-reading: $(STAMP)
	$(BIN)/python bench/reading.py

# Twice ten minutes of the studio's live view.
bench-live: $(STAMP)
	$(BIN)/python bench/live.py --minutes 10
	$(BIN)/python bench/live.py --minutes 10 --everywhere

# About half an hour: throughput, kills and cost of batches, for docs/scale.md.
bench-batch: $(STAMP)
	$(BIN)/python bench/batch.py

# About ten minutes: 100 SIGKILLs and 100 SIGINTs at random moments over eight commands.
kill: $(STAMP)
	$(BIN)/python bench/kill.py

# Runs the example scripts and makes their pictures.
examples: $(STAMP)
	rm -rf docs/examples
	mkdir docs/examples
	set -e; for each in $(CURDIR)/examples/*.py; do (cd docs/examples && $(CURDIR)/$(BIN)/python $$each); done
	rm docs/examples/*.dng docs/examples/*.toml

screenshots: $(STAMP)
	NOLENS_SCREENSHOTS=1 $(BIN)/pytest tests/studio/test_page_*.py

# The weights that come with nolens, from nothing: hours. It goes on where it was stopped; without
# build/weights it begins anew.
WEIGHTS := build/weights
training-photographs: $(STAMP) build/training/all.done

build/training/all.done:
	$(BIN)/python bench/training_photographs.py build/training
	touch $@

TRAINED := src/nolens/files/trained
weights: training-photographs $(WEIGHTS)/denoiser.done $(WEIGHTS)/unrolled.done $(WEIGHTS)/ridge.npz
	cp $(foreach each,unrolled ridge,$(WEIGHTS)/$(each).npz $(WEIGHTS)/$(each).json) $(TRAINED)

TRAIN = mkdir -p $(WEIGHTS) && $(BIN)/nolens train --photographs build/training/train --licence cc0-1.0 \
  --validation build/training/held-out --patience 100 -o $(WEIGHTS)/$(1).npz \
  $(if $(wildcard $(WEIGHTS)/$(1).state.npz),--resume $(WEIGHTS)/$(1).state.npz)

$(WEIGHTS)/denoiser.done: | training-photographs
	$(call TRAIN,denoiser) --prior denoiser --start none --steps 75000 --rate 0.0015 --pictures 1500 --precision bfloat16
	touch $@

# It mends what the denoiser that comes with nolens leaves: that has to be the new one.
$(WEIGHTS)/unrolled.done: $(WEIGHTS)/denoiser.done
	cp $(WEIGHTS)/denoiser.npz $(WEIGHTS)/denoiser.json $(TRAINED)
	$(call TRAIN,unrolled) --prior unrolled --start denoiser --steps 4000 --precision bfloat16
	touch $@

$(WEIGHTS)/ridge.npz: | training-photographs
	mkdir -p $(WEIGHTS)
	$(BIN)/python bench/ridge_weights.py --folder $(WEIGHTS)

# Damaged files, hostile options and requests for a while; what breaks is kept in build/fuzz/failures.
SECONDS ?= 600
fuzz: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python tests/fuzzing/run.py --seconds $(SECONDS)

# A studio of its own is attacked for some minutes, while the time in which it answers is measured.
attack: $(STAMP)
	PYTHONPATH=tests $(BIN)/python tests/studio/attack.py

clean:
	rm -rf $(VENV) .bench-venv
