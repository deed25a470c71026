# Every job of the project, the same here and in CI. A new machine needs python3 (3.11 or later) with venv, make and git.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
PYTHON ?= python3
UV_VERSION := 0.13.8
UV := .tools/bin/uv
TWINE_VERSION := 7.0.0
MKDOCS := --from mkdocs==1.6.1 --with mkdocs-material==9.8.1 --with mkdocstrings==1.0.8 --with mkdocstrings-python==2.0.11
RUN := .venv/bin
PYTHON_DIRS := client services deploy demos benchmarks tests tools web
PROPERTY_TESTS := tests/property $(addprefix tests/unit/supernode/core/,test_directory_properties.py \
	peers/test_peers_properties.py test_lease_safety.py)
# The folders of tests with a whole cluster. A test that cannot run with rules has the mark
# @pytest.mark.without_rules(reason). The target test-acl uses --tb=native: pytest's own tracebacks may exceed the recursion
# limit of Python 3.11's parser, and such an excess ends the run.
ACL_TESTS = tests/contract $(shell grep -rlE 'cluster_fixture|running_cluster' --include='test_*.py' tests/integration)
# A test may swallow the error of pytest-timeout, or hang in its teardown. Its process then writes all stacks and ends, and
# pytest-xdist begins a new process. Without a limit, xdist would give such a test to one new process after the other.
END_HANGS := -o faulthandler_timeout=660 -o faulthandler_exit_on_timeout=true --max-worker-restart 2
export UV_PYTHON_DOWNLOADS := never
# In some places bytecode files beside the sources are forbidden, as in many container images. All programs that run
# here then keep them below .make. Without them each of the hundreds of test processes would compile all its modules again.
ifdef PYTHONDONTWRITEBYTECODE
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/.make/pycache
endif

.PHONY: help setup demo demos test test-acl contract explore fuzz fuzz-cancels fuzz-parsers fuzz-ports race-rings mutants check format stubs robustness soak-metrics soak-page images wheels docs bench bench-docs bench-moves kill-moves kill-uploads cycles simulate clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 24

setup: .make/synced  ## bring every tool and dependency into .venv, as locked

$(UV):
	$(PYTHON) -m venv .tools
	.tools/bin/pip install --quiet uv==$(UV_VERSION)

.make/synced: $(UV) uv.lock pyproject.toml $(wildcard */pyproject.toml */*/pyproject.toml)
	$(UV) sync --quiet --frozen --python $(PYTHON)
	@mkdir -p .make && touch $@

demo: setup  ## the TV watcher: a real film through a real cluster, with a picture at the end
	$(RUN)/stampede demo tv-watcher --picture out/tv-watcher.png

demos: setup  ## all demos; the TV watcher and stereo run twice with rules of access: with client tokens, and with certificates
	for name in tv-watcher stereo; do for with in "" --certificates; do $(RUN)/stampede demo $$name $$with; done; done
	$(RUN)/stampede demo rover

# The tests of object stores need an S3 server. Go builds it once for each machine, which may take longer than a test may.
test: setup  ## the whole test suite
	-$(RUN)/python -m tests.support.channel_host.s3_server
	timeout --kill-after=30 3000 $(RUN)/pytest -n 5 --dist loadfile --no-loadscope-reorder $(END_HANGS)

test-acl: setup  ## the tests with a whole cluster; rules of access restrict the client of the tests
	STAMPEDE_TEST_ACL=1 $(RUN)/pytest -n 2 --dist loadfile --tb=native $(END_HANGS) $(ACL_TESTS)

contract: setup  ## the contract over every transport with both clients, also over transports that the suite leaves out: about 12 minutes
	STAMPEDE_EVERY_TRANSPORT=1 $(RUN)/pytest -n 3 --dist loadfile tests/contract

explore: setup  ## new random scenarios, other than those of the suite, against the oracles
	STAMPEDE_PROPERTY_EXAMPLES=5000 $(RUN)/pytest -n 2 --hypothesis-profile=explore --timeout=0 $(PROPERTY_TESTS)
	STAMPEDE_HOSTILE_SEEDS=400 $(RUN)/pytest -n 2 --timeout=0 tests/robustness/replication/test_hostile_peers.py

fuzz: fuzz-cancels fuzz-parsers fuzz-ports  ## all of the next three, for about 75 minutes; exit code 2 if anything is found

fuzz-cancels: setup  ## calls that are cancelled over a network that is cut, for 10 minutes; STAMPEDE_FUZZ_SEED names the first seed
	STAMPEDE_FUZZ_SCENARIOS=$${STAMPEDE_FUZZ_SCENARIOS:-15} STAMPEDE_FUZZ_SECONDS=$${STAMPEDE_FUZZ_SECONDS:-20} \
		$(RUN)/pytest -s --timeout=0 tests/robustness/fuzz/test_cancels_and_cuts.py

fuzz-parsers: setup  ## all parsers of bytes from outside, guided by coverage (atheris), a minute each
	$(UV) sync --quiet --frozen --python $(PYTHON) --group fuzz
	$(RUN)/python -m tests.robustness.fuzz.parsers --guided --inputs 10000000 --seconds $${STAMPEDE_FUZZ_SECONDS:-60}

fuzz-ports: setup  ## all RPCs of a host, its TCP port, a supernode and a front-end, a million requests each
	$(RUN)/python -m tests.robustness.fuzz.ports --inputs $${STAMPEDE_FUZZ_INPUTS:-1000000} --seed $${STAMPEDE_FUZZ_SEED:-1}

race-rings: setup  ## readers and the writer of a ring in shared memory at the same time, for 5 minutes, each payload with a checksum
	$(RUN)/python -m tests.robustness.rings.racing $${STAMPEDE_RACE_SECONDS:-300}

kill-moves: setup  ## kill -9 and SIGSTOP of source, destination and leader at each step of moves, and cuts of streams at any byte: about an hour
	STAMPEDE_EVERY_STEP=1 $(RUN)/pytest -q tests/robustness/moves/test_real_processes.py tests/robustness/moves/test_real_replicas.py \
		tests/robustness/moves/test_cut_streams.py
	STAMPEDE_EVERY_STEP=1 $(RUN)/pytest -q tests/robustness/takeovers/test_queue_moves_at_each_step.py

kill-uploads: setup  ## kill -9 at each of the 34 steps in which a segment moves to an object store, or a host stops (needs Go): about 8 minutes
	STAMPEDE_EVERY_STEP=1 $(RUN)/pytest -q tests/robustness/archives/test_killed_movers.py tests/robustness/archives/test_killed_stops.py

simulate: setup  ## take-overs and moves under random faults, 2000 seeds for channels and 2000 for queues: about an hour; SEEDS=100 for fewer
	$(RUN)/python -m tests.robustness.takeovers --processes $${PROCESSES:-2} --seeds $${SEEDS:-2000} --first $${FIRST:-0}

cycles: setup  ## open and close subscriptions, connections, channels and proxies 10,000 times each: no process may grow; CYCLES=1000 for fewer
	$(RUN)/python -m tests.robustness.cycles --cycles $${CYCLES:-10000}

mutants: setup  ## plant known faults in the directory's code, one at a time, and check that a test notices each
	$(RUN)/python -m tests.robustness.mutants

check: setup  ## lint, types, import rules, names, sizes, signposts, protobuf rules, freshness of generated files
	$(RUN)/ruff check $(PYTHON_DIRS)
	$(RUN)/ruff format --check $(PYTHON_DIRS)
	$(RUN)/python tools/generate.py --check
	$(RUN)/python tools/command_pages.py --check
	$(RUN)/mypy
	$(RUN)/lint-imports
	$(RUN)/python tools/class_names.py
	$(RUN)/python tools/private_names.py
	$(RUN)/python tools/plain_words.py
	$(RUN)/python tools/sizes.py
	$(RUN)/python tools/unit_tests.py
	$(RUN)/python tools/imported_names.py
	$(RUN)/python tools/log_events.py
	$(RUN)/python tools/signposts.py --check
	cd proto && ../$(RUN)/buf lint
	$(RUN)/python tools/breaking.py

format: setup  ## put the code into the project's form
	$(RUN)/ruff check --fix $(PYTHON_DIRS)
	$(RUN)/ruff format $(PYTHON_DIRS)

stubs: setup  ## generate the stubs, the synchronous client, the completion scripts and the man page, and draw the layers
	$(RUN)/python tools/generate.py
	$(RUN)/python tools/command_pages.py
	$(RUN)/python tools/signposts.py

robustness: setup  ## inject real faults into real clusters, for 25 minutes, with a report in out/robustness.md
	$(RUN)/pytest -m slow -n 2
	GRPC_VERBOSITY=NONE $(RUN)/python -m tests.robustness --report out/robustness.md
	$(RUN)/python -m tests.robustness.archives --rounds 10

soak-metrics: setup  ## Prometheus scrapes a cluster for ten minutes, while each part is killed in turn; MINUTES=1 for less
	$(RUN)/python -m tests.robustness.soaks.scraped --minutes $${MINUTES:-10}

soak-page: setup  ## Chromium shows the live page for ten minutes, while each part is killed in turn; MINUTES=1 for less
	$(RUN)/python -m tests.robustness.soaks.watched --minutes $${MINUTES:-10}

images: setup  ## build the images of deploy/ and prove the compose file, without a container engine
	deploy/prove_images

wheels: setup  ## wheels and source archives of all distributions, in out/wheels
	rm -rf out/wheels
	$(UV) build --quiet --all-packages --out-dir out/wheels
	$(UV) tool run --quiet --from twine==$(TWINE_VERSION) twine check --strict out/wheels/*.whl out/wheels/*.tar.gz

docs: setup  ## the site of the documentation, in out/site; see it with: python3 -m http.server -d out/site
	$(RUN)/python tools/docs_site.py
	NO_MKDOCS_2_WARNING=1 $(UV) tool run --quiet $(MKDOCS) mkdocs build --quiet --strict

bench: setup  ## items per second and latency, compared with bare gRPC
	$(RUN)/python -m tests.benchmarks.hot_path

bench-moves: setup  ## 100 moves of a channel and a queue under load: a table of the pauses that producers and readers notice
	$(RUN)/python -m tests.benchmarks.moves

bench-docs: setup  ## `stampede bench` into docs/benchmarks.md: some hours on a quiet machine; BENCH='--rounds 3' for less
	mkdir -p out/bench
	$(RUN)/stampede bench paper --out out/bench $(PAPER) > out/bench/paper.txt
	-$(RUN)/stampede bench growth --out out/bench $(GROWTH)
	-$(RUN)/stampede bench limits --out out/bench $(BENCH)
	-$(RUN)/stampede bench peers --out out/bench $(BENCH)
	$(RUN)/python tools/benchmark_docs.py out/bench

clean:  ## delete everything that these commands made
	rm -rf .venv .tools .make out
