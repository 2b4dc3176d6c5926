# The only front door: `make help` lists what it opens. Everything made lands in build/.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

# Which MPI: `make build MPI=mpich` builds with Debian's MPICH, into build/mpich.
export MPI := openmpi
SUFFIX := $(if $(filter-out openmpi,$(MPI)),.$(MPI))
PREFIX := build$(SUFFIX:.%=/%)

# What compiling needs. The command after the colon tells whether it is there.
define PACKAGES
gfortran:            command -v gfortran
$(MPI:openmpi=openmpi-bin): command -v mpirun$(SUFFIX)
lib$(MPI)-dev:       command -v mpifort$(SUFFIX)
pkg-config:          command -v pkg-config
libhdf5-$(MPI)-dev:  pkg-config --exists hdf5-$(MPI)
libgsl-dev:          pkg-config --exists gsl
libssl-dev:          pkg-config --exists libcrypto
python3-venv:        python3 -c 'import ensurepip, venv'
endef
export PACKAGES

# Compiler flags. fpm adds -fimplicit-none and -Werror=implicit-interface.
COMMON_FLAGS  := -std=f2018 -Wall -Wextra -Wno-maybe-uninitialized -Wno-uninitialized -fwrapv
RELEASE_FLAGS := $(COMMON_FLAGS) -O3 -march=native -flto -fno-math-errno -fno-trapping-math
DEBUG_FLAGS   := $(COMMON_FLAGS) -Werror -Og -g -fcheck=all -fbacktrace -finit-real=snan \
                 -ffpe-trap=invalid,zero,overflow

# Deferred, since pkg-config may be installed by this very make.
HDF5_INCLUDE = $(shell pkg-config --cflags-only-I hdf5-$(MPI))
HDF5_LIBRARY = $(shell pkg-config --libs-only-L hdf5-$(MPI))
LINK_FLAGS   = $(HDF5_LIBRARY)

export FPM_FC := mpifort$(SUFFIX)
export FPM_AR := gcc-ar
# Open MPI as root, and with more ranks than cores.
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_rmaps_base_oversubscribe := 1

VENV    := build/venv
PYTHON  := $(VENV)/bin/python
PROGRAM := build/bin/battery
RANKS   := 2
FULL    ?= 0

# Runs behind the figures; quick ones have a tenth of the collisions (lifetimes take their time).
CASES   := phase_diagram phase_diagram_polarised comp05 comp06 comp01 single_urn \
           lifetimes_one lifetimes_two lifetimes_long_gate
FIGURES := build/figures/$(if $(filter-out 0,$(FULL)),full,quick)
SHORTEN := $(if $(filter-out 0,$(FULL)),,s/(collisions *= *[0-9]+)0$$/\1/)

.PHONY: help demo test build bench probes accuracy figures lint clean install information

help: ## lists the targets
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/make \1\t\2/p' Makefile | expand -t 16

demo: build ## builds, runs namelists/quickstart.nml on 2 ranks, draws the pictures
	@mkdir -p build/demo
	cd build/demo
	mpirun -n $(RANKS) ../bin/battery --overwrite ../../namelists/quickstart.nml
	cd ../..
	$(PYTHON) -m postproc.currents build/demo/quickstart.h5 --output build/demo
	$(PYTHON) -m postproc.scene build/demo/quickstart.h5 --output build/demo
	echo "The pictures are in build/demo:"
	ls build/demo/*.png

test: build ## builds, runs the tests; at the end "N passed, M failed"; FULL=1: all, also slow ones
	@$(PYTHON) test/all.py $(if $(filter-out 0,$(FULL)),--full) --ldflags=" $(LINK_FLAGS)" \
	  --release=" $(RELEASE_FLAGS) $(HDF5_INCLUDE)" --debug=" $(DEBUG_FLAGS) $(HDF5_INCLUDE)"

build: install information ## only builds: the program is build/bin/battery; MPI=mpich: build/mpich/bin/battery
	@export FPM_FFLAGS="$(RELEASE_FLAGS) $(HDF5_INCLUDE)" FPM_LDFLAGS="-flto $(LINK_FLAGS)"
	flock build/.lock $(VENV)/bin/fpm install --prefix $(PREFIX)

bench: build ## the speed tables, and what must be reached; JSON in build/bench
	@if command -v valgrind > /dev/null; then $(MAKE) build/counted/bin/bench; fi
	$(PYTHON) -m postproc.benchmarks run

# For callgrind, which knows no AVX-512: fpm keeps a build for each set of flags.
.PHONY: build/counted/bin/bench
build/counted/bin/bench: install information
	@export FPM_FFLAGS="$(subst -march=native,-march=x86-64-v3,$(RELEASE_FLAGS)) $(HDF5_INCLUDE)"
	export FPM_LDFLAGS="-flto $(LINK_FLAGS)"
	mkdir -p build/counted
	echo "Building for x86-64-v3, to count instructions"
	flock build/.lock $(VENV)/bin/fpm install --prefix build/counted > build/counted/log 2>&1 || \
	  { cat build/counted/log; exit 1; }

# The physics in single, double and quadruple precision, and the program that asks it questions: a
# package of its own, of the same sources. fpm keeps a build for each set of flags.
define PROBE_PACKAGE
name = "accuracy"
version = "0.1.0"
[build]
auto-executables = false
auto-tests = false
auto-examples = false
link = ["gsl", "gslcblas"]
external-modules = ["hdf5", "h5ds", "mpi_f08"]
[library]
source-dir = "../../src"
include-dir = "../generated"
[[executable]]
name = "accuracy"
source-dir = "../../app"
main = "accuracy.f90"
endef
export PROBE_PACKAGE
PRECISIONS := real32 real64 real128

probes: build $(PRECISIONS:%=build/bin/accuracy-%)

.PHONY: $(PRECISIONS:%=build/bin/accuracy-%)
$(PRECISIONS:%=build/bin/accuracy-%): build/bin/accuracy-real%: install information
	@mkdir -p build/probe/real$*
	echo "$$PROBE_PACKAGE" > build/probe/fpm.toml
	cd build/probe
	export FPM_FFLAGS="$(RELEASE_FLAGS) -DBATTERY_REAL$*" FPM_LDFLAGS="-flto"
	echo "Building the physics in real$*"
	flock .lock ../venv/bin/fpm install --prefix real$* > real$*/log 2>&1 || { cat real$*/log; exit 1; }
	install real$*/bin/accuracy ../bin/accuracy-real$*

accuracy: build probes ## the speed-accuracy charts and the stability tables; FULL=1: long runs
	@$(PYTHON) -m postproc.accuracy --ranks $(RANKS) $(if $(filter-out 0,$(FULL)),--full)

figures: build ## every figure of the paper, quick; FULL=1: at the paper's own length
	@mkdir -p $(FIGURES)
	cd $(FIGURES)
	for case in $(CASES); do
	  sed -E '$(SHORTEN)' $(CURDIR)/namelists/$$case.nml > $$case.nml
	  mpirun -n $(RANKS) $(CURDIR)/$(PROGRAM) $$case.nml
	done
	cd $(CURDIR)
	figure() { $(PYTHON) -m postproc.figures "$$1" "$${@:2}" --output $(FIGURES); }
	figure model
	figure numris $(FIGURES)/phase_diagram.h5 $(FIGURES)/phase_diagram_polarised.h5
	for name in comp05 comp06 comp01; do figure $$name $(FIGURES)/$$name.h5; done
	for name in app2 app3 app4; do figure $$name $(FIGURES)/single_urn.h5; done
	figure lifetimes $(FIGURES)/lifetimes_{one,two,long_gate}.h5
	echo "The figures are in $(FIGURES)"

lint: install ## style of the Fortran and the Python sources
	@$(VENV)/bin/fortitude check --output-format concise src app test
	$(VENV)/bin/ruff check --config postproc/ruff.toml postproc test

clean: ## removes everything made, the virtual environment too
	rm -rf build

# What is missing is installed once; the stamps remember that it is there.
install: build/stamps/packages$(SUFFIX) build/stamps/python

build/stamps/packages$(SUFFIX): Makefile
	@mkdir -p build/stamps
	missing=()
	while IFS=: read -r package question; do
	  bash -c "$$question" > /dev/null 2>&1 || missing+=("$$package")
	done <<< "$$PACKAGES"
	if (( $${#missing[@]} )); then
	  if [[ $$(id -u) == 0 ]]; then
	    as_root=
	  elif sudo -n true 2> /dev/null; then
	    as_root='sudo -n'
	  else
	    echo "These packages are missing, and only root may install them: $${missing[*]}" >&2
	    exit 1
	  fi
	  echo "Installing the packages $${missing[*]}"
	  { $$as_root apt-get update -qq &&
	    $$as_root env DEBIAN_FRONTEND=noninteractive \
	      apt-get install -y -qq --no-install-recommends "$${missing[@]}"; } \
	    > build/stamps/apt.log 2>&1 || {
	    tail -n 20 build/stamps/apt.log >&2
	    echo "These packages are missing and could not be installed: $${missing[*]}" >&2
	    exit 1
	  }
	fi
	touch $@

build/stamps/python: postproc/requirements.txt | build/stamps/packages$(SUFFIX)
	@echo "Installing the Python packages of postproc/requirements.txt in $(VENV)"
	[[ -x $(PYTHON) ]] || python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r postproc/requirements.txt
	touch $@

# Version and git commit for src/base/build_information.f90. fpm does not watch included files, so
# the object that has them is removed when they change; objects for another processor go as well.
information: build/stamps/packages$(SUFFIX)
	@mkdir -p build/generated
	version=$$(sed -nE 's/^version = "(.*)"/\1/p' fpm.toml)
	commit=$$(git describe --always --dirty --abbrev=40 --exclude='*' 2> /dev/null || echo unknown)
	new=$$(printf "character(len=*), parameter :: %s = '%s'\n" \
	  program_version "$$version" git_commit "$$commit")
	if [[ "$$new" != "$$(cat build/generated/build_information.inc 2> /dev/null)" ]]; then
	  echo "$$new" > build/generated/build_information.inc
	  rm -f build/mpifort*/battery/*build_information.f90.o*
	fi
	# fpm keeps objects of sources that are gone or have moved.
	sources=$$(find src app -name '*.[fF]90' -o -name '*.c' | sort | sha256sum)
	if [[ "$$sources" != "$$(cat build/stamps/sources 2> /dev/null)" ]]; then
	  rm -rf build/mpifort* build/probe/build build/test_package
	  echo "$$sources" > build/stamps/sources
	fi
	processor=$$(gfortran -march=native -Q --help=target | sha256sum)
	if [[ "$$processor" != "$$(cat build/stamps/processor 2> /dev/null)" ]]; then
	  rm -rf build/mpifort* build/probe/build
	  echo "$$processor" > build/stamps/processor
	fi
