"""Spack's recipe for battery; how to use it: docs/install.md."""

from spack.package import *
from spack_repo.builtin.build_systems.makefile import MakefilePackage


class Battery(MakefilePackage):
    """Event-driven simulation of gated circular billiards with deterministic currents.

    The program, its library and its man page. The Python side is apart: `pip install .` in the
    checkout.
    """

    # There is no release to fetch: `spack dev-build`, or `dev_path=CHECKOUT`, builds a checkout.
    has_code = True

    version("main")

    depends_on("c", type="build")
    depends_on("fortran", type="build")
    depends_on("fpm@0.12:", type="build")
    depends_on("gmake", type="build")
    depends_on("python@3.11:", type="build")
    depends_on("mpi")
    depends_on("hdf5@1.10: +fortran +hl +shared")
    depends_on("gsl@2.7:")
    depends_on("openssl@3:")

    # The switches are those of gfortran.
    requires("%fortran=gcc@11:")

    parallel = False

    # `make test` wants Python packages; what was installed is tested below.
    build_time_test_callbacks = []

    def choices(self):
        """What `make` is told: where everything is, and which processor."""
        flags = self.spec.target.optimization_flags("gcc", str(self.spec["fortran"].version))
        march = [flag.split("=")[1] for flag in flags.split() if flag.startswith("-march=")]
        return [
            f"MPIFC={self.spec['mpi'].mpifc}",
            f"HDF5={self.spec['hdf5'].prefix}",
            f"GSL={self.spec['gsl'].prefix}",
            f"OPENSSL={self.spec['openssl'].prefix}",
            f"FPM={self.spec['fpm'].prefix.bin.fpm}",
            *[f"MARCH={one}" for one in march[:1]],
        ]

    def build(self, spec, prefix):
        make("build", *self.choices())

    def install(self, spec, prefix):
        make("install", f"PREFIX={prefix}", "POSTPROC=0", *self.choices())

    @run_after("install")
    @on_package_attributes(run_tests=True)
    def self_test(self):
        """`spack install --test=root`: whether what was installed works."""
        Executable(self.prefix.bin.battery)("--self-test")
