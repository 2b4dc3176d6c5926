# The only front door: `make help` lists what it opens. Everything made lands in build/.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
# Targets make the same things; what takes long runs in parallel by itself.
.NOTPARALLEL:

# Which MPI: `make build MPI=mpich` builds with Debian's MPICH, into build/mpich.
export MPI := openmpi
SUFFIX := $(if $(filter-out openmpi,$(MPI)),.$(MPI))
BUILT  := build$(SUFFIX:.%=/%)

# What else a user may say: the compiler, the wrapper of MPI that calls it, the processor, folders that
# libraries are installed in, an fpm. What `make build` was told holds until it is told otherwise.
CHOICES := MPIFC FC MARCH HDF5 GSL OPENSSL FPM
ifeq ($(origin FC),default)
undefine FC
endif
# Some clusters set FC to the wrapper.
ifneq ($(findstring mpi,$(notdir $(FC))),)
MPIFC ?= $(FC)
override FC :=
endif
-include build/choices$(SUFFIX)
MPIFC ?= mpifort$(SUFFIX)
MARCH ?= native
override HDF5 := $(abspath $(HDF5))
override GSL := $(abspath $(GSL))
override OPENSSL := $(abspath $(OPENSSL))
export MPIFC FC MARCH HDF5 GSL OPENSSL FPM
ifneq ($(FC),)
export OMPI_FC := $(FC)
export MPICH_FC := $(FC)
endif

# Switches of compiler and linker. fpm adds -fimplicit-none and -Werror=implicit-interface.
ask = $(shell MPI='$(MPI)' MPIFC='$(MPIFC)' HDF5='$(HDF5)' GSL='$(GSL)' OPENSSL='$(OPENSSL)' \
      MARCH='$(MARCH)' packaging/switches $1)
RELEASE_FLAGS = $(call ask,compile release)
RELEASE_LINK  = $(call ask,link release)
DEBUG_FLAGS   = $(call ask,compile debug)
DEBUG_LINK    = $(call ask,link debug)

# A setting for installing outside of environments would stop pip in this one.
export PIP_USER := 0

# fpm: what the user says, that of the virtual environment, that of the PATH, or pip installs one.
# Another program has that name, too.
fpm := $(abspath $(or $(shell command -v '$(FPM)'),$(FPM),$(wildcard build/venv/bin/fpm), \
       $(shell [[ $$(fpm --version 2> /dev/null) == *fpm* ]] && command -v fpm),build/venv/bin/fpm))

export FPM_FC := $(MPIFC)
export FPM_AR := gcc-ar
export FPM_CFLAGS := $(call ask,c)
# Open MPI as root, and with more ranks than cores (4; 5). postproc/launcher.py has these for Python.
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_rmaps_base_oversubscribe := 1
export PRTE_MCA_rmaps_default_mapping_policy := :oversubscribe
# Not that of a Jupyter kernel.
export MPLBACKEND := agg

PREFIX  ?= /usr/local
POSTPROC ?= 1
VENV    := build/venv
PYTHON  := $(VENV)/bin/python
# The Python side, importable by that Python from every folder, and its commands.
COMMANDS := $(VENV)/bin/battery-postproc
PROGRAM := $(BUILT)/bin/battery
SOURCES := Makefile fpm.toml packaging/switches $(shell find src app -type f)
RANKS   := 2
FULL    ?= 0

.PHONY: help demo test cluster build docs lint clean install prefix libraries relocate information

help: ## lists the targets
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/make \1\t\2/p' $(filter-out build/%,$(MAKEFILE_LIST)) | expand -t 18

demo: build $(COMMANDS) ## builds, runs namelists/quickstart.nml on 2 ranks, draws the pictures
	@mkdir -p build/demo
	rm -f build/demo/quickstart_*
	cd build/demo
	mpirun -n $(RANKS) $(CURDIR)/$(PROGRAM) --overwrite ../../namelists/quickstart.nml
	for name in flows scene; do $(CURDIR)/$(COMMANDS) plot $$name quickstart.h5 > log; done
	echo "The results are build/demo/quickstart.h5, the pictures:"
	cd ../..
	ls build/demo/*.png

test: build $(COMMANDS) ## builds, runs the tests; at the end "N passed, M failed"; FULL=1: all, also slow ones
	@$(PYTHON) test/all.py $(if $(filter-out 0,$(FULL)),--full) --built=$(BUILT) \
	  --release=" $(RELEASE_FLAGS)" --release-link=" $(RELEASE_LINK)" \
	  --debug=" $(DEBUG_FLAGS)" --debug-link=" $(DEBUG_LINK)"

cluster: build $(COMMANDS) ## as root: a Slurm of two nodes here runs the example jobs, machines die; then it is gone
	@$(PYTHON) test/support/cluster_packages.py
	$(PYTHON) -m pytest -q -rs test/test_slurm.py test/test_nodes.py

# What a user may say: docs/install.md.
build: libraries $(fpm) information ## builds build/bin/battery and installs the Python side (not: POSTPROC=0) in build/venv; MPI=mpich MARCH=x86-64-v3 HDF5=DIR FC= MPIFC= GSL= FPM=
	@export FPM_FFLAGS="$(RELEASE_FLAGS)" FPM_LDFLAGS="$(RELEASE_LINK)"
	echo "Building $(PROGRAM) (log: $(BUILT)/log)"
	mkdir -p $(BUILT)
	# What a link that was interrupted has left fpm would take for the program.
	flock build/.lock find build -maxdepth 3 -path '*/app/battery' ! -perm -u+x -delete
	flock build/.lock $(fpm) install --prefix $(BUILT) > $(BUILT)/log 2>&1 || { cat $(BUILT)/log >&2; exit 1; }
	[[ "$(POSTPROC)" == 0 ]] || $(MAKE) $(COMMANDS) || {
	  echo "The program is complete: $(PROGRAM). Its Python side needs packages that pip could not get;"
	  echo "make build POSTPROC=0 leaves it out."
	}

# A program beside battery, for tests and studies: a package of its own, of src and of the folders that
# it names, of which fpm compiles what is used. fpm keeps a build for each set of flags.
define BESIDE_PACKAGE
name = "NAME"
version = "0.1.0"
[build]
auto-executables = false
auto-tests = false
auto-examples = false
link = ["gsl", "gslcblas"]
external-modules = ["hdf5", "h5ds", "mpi_f08"]
[library]
source-dir = "library"
[[executable]]
name = "NAME"
source-dir = "program"
main = "NAME.f90"
endef
export BESIDE_PACKAGE

# $(call beside,NAME,VARIANT,FOLDER,MODULES): the build of FOLDER/NAME.f90, with modules of that folder
# and of the folder MODULES (may be left out), with the flags of the environment.
define beside
echo "Building $1 for $2"
mkdir -p build/beside/$1/library build/beside/$1/$2 $(CURDIR)/$(@D)
echo "$${BESIDE_PACKAGE//NAME/$1}" > build/beside/$1/fpm.toml
cd build/beside/$1
ln -sfn ../../../$3 program
ln -sfn ../../../../src library/src
$(if $4,ln -sfn ../../../../$4 library/modules)
flock .lock find . -maxdepth 4 -path '*/app/$1' ! -perm -u+x -delete
flock .lock $(fpm) install --prefix $2 > $2/log 2>&1 || { cat $2/log; exit 1; }
install $2/bin/$1 $(CURDIR)/$@
endef

# What freezes answers anew (test/frozen/freeze.py): the events of a run in one precision.
build/bin/events-real%: FORCE | libraries $(fpm) information
	@export FPM_FFLAGS="$(RELEASE_FLAGS) -DBATTERY_REAL$*" FPM_LDFLAGS="-flto=auto"
	$(call beside,events,real$*,test/frozen)

FORCE:

# For processors that are named: callgrind knows no AVX-512, and there are promises about both.
PROCESSORS := x86-64-v3 x86-64-v4

$(PROCESSORS:%=build/%/bin/battery): build/%/bin/battery: FORCE | libraries $(fpm) information
	@mkdir -p build/$*
	export FPM_FFLAGS="$(subst -march=$(MARCH),-march=$*,$(RELEASE_FLAGS))"
	export FPM_LDFLAGS="$(RELEASE_LINK)"
	echo "Building for $*"
	flock build/.lock $(fpm) install --prefix build/$* > build/$*/log 2>&1 || \
	  { cat build/$*/log; exit 1; }

# Targets of the studies, where these are there.
-include studies/targets.mk

docs: build build/stamps/docs ## the manual: build/site/index.html opens from disk, with search and formulas
	@rm -rf build/site
	$(PYTHON) docs/manual/reference.py
	PYTHONPATH=docs/manual nice $(PYTHON) -m sphinx -E -W --keep-going -q -b html -c docs/manual -d build/manual/doctrees \
	  . build/site || { rm -rf build/site; echo "no site was made" >&2; exit 1; }
	echo "build/site/index.html ($$(du -sh build/site | cut -f 1))"

build/stamps/docs: docs/requirements.txt $(COMMANDS)
	@echo "Installing the Python packages of docs/requirements.txt in $(VENV)"
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r docs/requirements.txt
	touch $@

lint: $(COMMANDS) ## style of the Fortran and the Python sources
	@$(VENV)/bin/fortitude check --output-format concise src app test docs $(wildcard studies)
	$(VENV)/bin/ruff check --config postproc/ruff.toml postproc test docs $(wildcard studies)
	$(VENV)/bin/ruff format --check --config postproc/ruff.toml postproc test docs $(wildcard studies)
	$(VENV)/bin/mypy --no-error-summary

install: prefix information $(PROGRAM) ## program, library, man page, module file, Python side (not: POSTPROC=0) into PREFIX (default: /usr/local)
	@prefix=$$(realpath -m -- "$(PREFIX)")
	version=$$($(PROGRAM) --version | sed -n '1s/battery \([^ ]*\).*/\1/p')
	install $(PROGRAM) "$$prefix/bin"
	install -m 644 $(BUILT)/lib/libbattery.a "$$prefix/lib"
	rm -f "$$prefix/include/battery/"*.mod
	modules=$$(find src -name '*.[fF]90' -exec sed -nE 's/^module (\w+)$$/\1.mod/p' {} +)
	(cd $(BUILT)/include; install -m 644 $$(ls $$modules 2> /dev/null) "$$prefix/include/battery")
	sed -e "s|@version@|$$version|" -e "s|@switches@|$(RELEASE_LINK)|" packaging/battery.pc.in \
	  > "$$prefix/lib/pkgconfig/battery.pc"
	sed -e "s|@version@|$$version|" -e "s|@prefix@|$$prefix|" packaging/modulefile.in \
	  > "$$prefix/share/modulefiles/battery/$$version"
	if command -v python3 > /dev/null; then
	  python3 docs/man_page.py $(PROGRAM) > "$$prefix/share/man/man1/battery.1"
	else
	  echo "no man page: it takes a python3"
	fi
	echo "battery is in $$prefix/bin; battery --self-test says whether it works"
	[[ "$(POSTPROC)" != 0 ]] || exit 0
	python3 -m venv "$$prefix/lib/battery"
	"$$prefix/lib/battery/bin/python" -m pip install --quiet --disable-pip-version-check \
	  --upgrade --constraint postproc/requirements.txt '.[report,film]'
	ln -sf ../lib/battery/bin/battery-postproc "$$prefix/bin"
	echo "battery-postproc is in $$prefix/bin"

# What is there and newer than all that it is made of is not built again.
$(PROGRAM): $(SOURCES) build/choices$(SUFFIX) build/generated/commit.h
	@$(MAKE) build POSTPROC=0
	touch $@

# The folders of an installation; whether they can be written to is asked before anything is built.
prefix:
	@prefix=$$(realpath -m -- "$(PREFIX)")
	for folder in bin lib/pkgconfig lib/battery include/battery share/man/man1 share/modulefiles/battery; do
	  mkdir -p "$$prefix/$$folder" 2> /dev/null && [[ -w "$$prefix/$$folder" ]] || {
	    echo "$$prefix/$$folder: cannot be written to; make install PREFIX=DIR takes another place" >&2
	    exit 1
	  }
	done

clean: ## removes everything made, the virtual environment too
	rm -rf build

# What compiling needs is installed once, where that is allowed; the stamps remember that it is there.
libraries: build/stamps/packages$(SUFFIX)

build/stamps/packages$(SUFFIX): packaging/switches build/choices$(SUFFIX) | relocate
	@mkdir -p build/stamps
	if ! missing=$$(packaging/switches missing apt); then
	  if [[ $$(id -u) == 0 ]]; then as_root=; else as_root='sudo -n'; fi
	  if [[ -n "$$missing" ]] && command -v apt-get > /dev/null && $$as_root true 2> /dev/null; then
	    echo "Installing the packages $$missing"
	    { $$as_root apt-get update -qq &&
	      $$as_root env DEBIAN_FRONTEND=noninteractive \
	        apt-get install -y -qq --no-install-recommends $$missing; } \
	      > build/stamps/apt.log 2>&1 || tail -n 20 build/stamps/apt.log >&2
	  fi
	  packaging/switches missing >&2 || {
	    mv -f build/choices$(SUFFIX){.before,} 2> /dev/null || true
	    exit 1
	  }
	fi
	rm -f build/choices$(SUFFIX).before
	touch $@

# One that the user names, and that is not there.
$(filter-out $(abspath build/venv/bin/fpm),$(fpm)):
	@echo "FPM=$@: there is no such program; how to get one: docs/install.md" >&2
	exit 1

# What was said, for the next make: written only where it is new. What does not work is forgotten
# again (above).
build/choices$(SUFFIX): FORCE
	@mkdir -p build
	said=$$(printf '%s\n' $(foreach name,$(CHOICES),$(if $($(name)),'$(name) ?= $($(name))')))
	[[ "$$said" != "$$(cat $@ 2> /dev/null)" ]] || exit 0
	[[ -e $@.before ]] || cp $@ $@.before 2> /dev/null || : > $@.before
	echo "$$said" > $@

# In a checkout that was moved or copied: the files of its virtual environment name the old folder.
# One that two checkouts share, by a link, stays that of the first.
relocate:
	@file=$$(ls $(VENV)/lib/*/site-packages/battery.pth 2> /dev/null) && old=$$(cat "$$file") || exit 0
	[[ -n "$$old" && ! $(VENV) -ef "$$old/$(VENV)" ]] || exit 0
	echo "Renaming $$old in $(VENV)"
	grep -lIF "$$old/$(VENV)" $(VENV)/bin/* | xargs -r -d '\n' $(PYTHON) -c 'import fileinput, sys; \
	  [print(line.replace(*sys.argv[1:3]), end="") for line in fileinput.input(sys.argv[3:], inplace=True)]' \
	  "$$old" '$(CURDIR)'
	[[ ! -d $(BUILT)/bin ]] || ln -srf $(COMMANDS) $(BUILT)/bin
	echo '$(CURDIR)' > "$$file"

$(abspath build/venv/bin/fpm): | build/stamps/packages$(SUFFIX)
	@wanted=$$(grep '^fpm==' postproc/requirements.txt)
	echo "Installing $$wanted in $(VENV)"
	[[ -x $(VENV)/bin/pip ]] || python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check "$$wanted" || {
	  echo "fpm is missing. make build FPM=PATH takes one; how to get it without a network:" \
	    "docs/install.md" >&2
	  exit 1
	}

build/stamps/python: postproc/requirements.txt | build/stamps/packages$(SUFFIX)
	@echo "Installing the Python packages of postproc/requirements.txt in $(VENV)"
	[[ -x $(VENV)/bin/pip ]] || python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r postproc/requirements.txt
	touch $@

$(COMMANDS): build/stamps/python
	@packages=$$($(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
	echo '$(CURDIR)' > "$$packages/battery.pth"
	printf '#!%s\nfrom postproc.__main__ import run\n\nraise SystemExit(run())\n' '$(CURDIR)/$(PYTHON)' > $@
	chmod +x $@
	# Beside the program, which names it in what it prints.
	mkdir -p $(BUILT)/bin
	ln -srf $@ $(BUILT)/bin

# The git commit for src/interop/commit.c. fpm does not watch files that may not be there, so the object
# that has it is removed when it changes; objects for another processor or compiler go as well.
information: build/generated/commit.h

OBJECTS := build/*_[0-9A-F][0-9A-F][0-9A-F][0-9A-F][0-9A-F][0-9A-F]*

build/generated/commit.h: FORCE | build/stamps/packages$(SUFFIX)
	@mkdir -p build/generated
	# Of this tree, and not of one around it, or of the one whose hook runs this.
	unset $$(git rev-parse --local-env-vars 2> /dev/null)
	tree="--git-dir=.git --work-tree=."
	commit=$$(git $$tree describe --always --dirty --abbrev=40 --exclude='*' 2> /dev/null || echo unknown)
	new="#define BATTERY_COMMIT \"$$commit\""
	# To another user, as root for whom make install is called, git may say nothing.
	if [[ "$$new" != "$$(cat $@ 2> /dev/null)" && ! ( $$commit == unknown && -e .git && -e $@ ) ]]; then
	  echo "$$new" > $@
	  rm -f $(OBJECTS)/battery/*commit.c.o* build/beside/*/$(OBJECTS)/*/*commit.c.o*
	fi
	# fpm keeps objects of sources that are gone or have moved.
	sources=$$(find src app $(wildcard test/frozen studies) -name '*.[fF]90' -o -name '*.c' | sort | sha256sum)
	if [[ "$$sources" != "$$(cat build/stamps/sources 2> /dev/null)" ]]; then
	  rm -rf $(OBJECTS) build/beside build/test_package
	  echo "$$sources" > build/stamps/sources
	fi
	processor=$$({ $(MPIFC) --version; $(MPIFC) -march=$(MARCH) -Q --help=target; } | sha256sum)
	if [[ "$$processor" != "$$(cat build/stamps/processor$(SUFFIX) 2> /dev/null)" ]]; then
	  rm -rf $(OBJECTS) build/beside
	  echo "$$processor" > build/stamps/processor$(SUFFIX)
	fi
