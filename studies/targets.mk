# Targets of the studies; the Makefile includes this file where it is there.

.PHONY: bench probes accuracy experiments figures

bench: build/bin/bench $(COMMANDS) ## the speed tables, JSON in build/bench; BASE=COMMIT: ratios to a commit of ours
	@if [[ -n "$(BASE)" ]]; then
	  commit=$$(git rev-parse --quiet --verify --short=10 "$(BASE)^{commit}") || {
	    echo "BASE=$(BASE): no such commit of this repository" >&2
	    exit 2
	  }
	  $(MAKE) build/base-$$commit/build/bin/bench
	  exec $(PYTHON) -m studies.speed.study build/base-$$commit/build/bin/bench
	fi
	if command -v valgrind > /dev/null; then $(MAKE) build/x86-64-v3/bin/bench; fi
	$(PYTHON) -m studies.speed.study

build/bin/bench: FORCE | libraries $(fpm) information
	@export FPM_FFLAGS="$(RELEASE_FLAGS)" FPM_LDFLAGS="$(RELEASE_LINK)"
	$(call beside,bench,$(MARCH),studies/speed/programs,studies/common)

# An earlier commit, in a clone of its own, built with the present switches; up to 0.3.0 its programs
# are in app.
build/base-%/build/bin/bench: FORCE | libraries $(fpm)
	@[[ -d build/base-$* ]] || git clone --quiet --shared --no-checkout . build/base-$*
	cd build/base-$*
	git checkout --quiet $*
	$(MAKE) information
	programs=studies/speed/programs
	[[ -d $$programs ]] || programs=app
	# Up to version 0.1.0 a file that make writes is included.
	export FPM_FFLAGS="$(RELEASE_FLAGS) -I$$PWD/build/generated" FPM_LDFLAGS="$(RELEASE_LINK)"
	$(call beside,bench,commit-$*,$$programs,studies/common)

$(PROCESSORS:%=build/%/bin/bench): build/%/bin/bench: FORCE | libraries $(fpm) information
	@export FPM_FFLAGS="$(subst -march=$(MARCH),-march=$*,$(RELEASE_FLAGS))"
	export FPM_LDFLAGS="$(RELEASE_LINK)"
	$(call beside,bench,$*,studies/speed/programs,studies/common)

# The physics in single, double and quadruple precision, and the program that asks it questions.
PRECISIONS := real32 real64 real128

probes: build $(PRECISIONS:%=build/bin/accuracy-%)

$(PRECISIONS:%=build/bin/accuracy-%): build/bin/accuracy-real%: FORCE | libraries $(fpm) information
	@export FPM_FFLAGS="$(RELEASE_FLAGS) -DBATTERY_REAL$*" FPM_LDFLAGS="-flto=auto"
	$(call beside,accuracy,real$*,studies/accuracy/programs,studies/common)

# Walkers, which postproc asked up to 0.3.0.
build/bin/one_particle: FORCE | libraries $(fpm) information
	@export FPM_FFLAGS="$(RELEASE_FLAGS)" FPM_LDFLAGS="$(RELEASE_LINK)"
	$(call beside,one_particle,$(MARCH),studies/one_particle/programs,studies/common)

accuracy: build probes $(COMMANDS) ## the speed-accuracy charts and the stability tables; FULL=1: long runs
	@for study in accuracy trajectories gated_reversal; do
	  $(PYTHON) -m studies.$$study.study --ranks $(RANKS) $(if $(filter-out 0,$(FULL)),--full)
	done

experiments: build $(COMMANDS) ## five experiments that decide whether urns remember; FULL=1: long runs
	@$(PYTHON) -m studies.experiments.study --ranks $(RANKS) $(if $(filter-out 0,$(FULL)),--full)

# Runs behind the figures; quick ones have a tenth of the collisions (lifetimes take their time).
CASES   := phase_diagram phase_diagram_polarised comp05 comp06 comp01 single_urn \
           lifetimes_one lifetimes_two lifetimes_long_gate lifetimes_rare_one lifetimes_rare_long_gate
FIGURES := build/figures/$(if $(filter-out 0,$(FULL)),full,quick)
SHORTEN := $(if $(filter-out 0,$(FULL)),,s/(collisions *= *[0-9]+)0$$/\1/)

figures: build $(COMMANDS) ## every figure of the paper, quick; FULL=1: at the paper's own length
	@mkdir -p $(FIGURES)
	cd $(FIGURES)
	for case in $(CASES); do
	  sed -E '$(SHORTEN)' $(CURDIR)/namelists/$$case.nml > $$case.nml
	  mpirun -n $(RANKS) $(CURDIR)/$(PROGRAM) $$case.nml
	done
	cd $(CURDIR)
	figure() { $(COMMANDS) plot "$$1" "$${@:2}" --output $(FIGURES); }
	figure model
	figure app1
	figure numris $(FIGURES)/phase_diagram.h5 $(FIGURES)/phase_diagram_polarised.h5 \
	  --theory window direction
	for name in comp05 comp06 comp01; do figure $$name $(FIGURES)/$$name.h5; done
	for name in app2 app3 app4; do figure $$name $(FIGURES)/single_urn.h5; done
	figure lifetimes $(FIGURES)/lifetimes_{one,two,long_gate,rare_one,rare_long_gate}.h5
	echo "The figures are in $(FIGURES)"
