"""Do the tests bite? The production chain broken in thirty ways, each against the tests that stand nearest to it.

    python benchmarks/mutants.py                  all; about ten minutes
    python benchmarks/mutants.py --only NAME ...  some of them
    python benchmarks/mutants.py --quick          the first: does it still run?

Each mutant changes one expression in a copy of the checkout; its tests must fail there, and pass without it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
CHAIN = "tests/sim/run/test_production_chain.py"
SIGMAS = "tests/calib/common/test_sigmas.py"


class Mutant(NamedTuple):
    """One change of one line."""

    file: str
    right: str
    wrong: str
    tests: str


MUTANTS: dict[str, Mutant] = {
    "noise x 1.05": Mutant("sim/run/chain.py", "noise_nT = instrument.", "noise_nT = 1.05 * instrument.", CHAIN),
    "noise x 2": Mutant("sim/run/chain.py", "noise_nT = instrument.", "noise_nT = 2.0 * instrument.", CHAIN),
    "unknown field x 2": Mutant("sim/run/chain.py", "(time, source.nT,", "(time, 2.0 * source.nT,", CHAIN),
    "floor for rint": Mutant("sim/spacecraft/sensors/magnetometer.py", "np.rint(reading", "np.floor(reading", CHAIN),
    "S transposed": Mutant(
        "sim/spacecraft/sensors/magnetometer.py",
        "np.linalg.inv(np.eye(3) + self.S))",
        "np.linalg.inv(np.eye(3) + self.S.T))",
        CHAIN,
    ),
    "sign of b": Mutant(
        "sim/spacecraft/sensors/magnetometer.py",
        "dtype=np.float64)) - self.b_nT",
        "dtype=np.float64)) + self.b_nT",
        CHAIN,
    ),
    "sign of T of the sensor": Mutant(
        "sim/spacecraft/sensors/magnetometer.py",
        "corrected - np.atleast_2d(dip",
        "corrected + np.atleast_2d(dip",
        CHAIN,
    ),
    "sign of T from positions": Mutant(
        "sim/run/spacecraft.py",
        "return (scenario.torquers.compensation - 1.0) *",
        "return (1.0 - scenario.torquers.compensation) *",
        CHAIN,
    ),
    "compensation the wrong way": Mutant(
        "sim/run/spacecraft.py",
        "(scenario.torquers.compensation - 1.0)",
        "(-scenario.torquers.compensation - 1.0)",
        "tests/scenarios/test_hcmm_gallery.py tests/scenarios/test_study_motion.py",
    ),
    "yaw in radians": Mutant(
        "sim/run/true_attitude.py", "np.radians(a.yaw_rms_deg)", "np.asarray(a.yaw_rms_deg)", CHAIN
    ),
    "pitch and roll exchanged": Mutant(
        "sim/run/true_attitude.py", "np.radians(a.roll_rms_deg)", "np.radians(a.pitch_rms_deg)", CHAIN
    ),
    "head's misalignment in radians": Mutant(
        "sim/spacecraft/sensors/sun_sensor.py", "(float(np.radians(angle)) for angle", "(float(angle) for angle", CHAIN
    ),
    "sun sensor's noise in radians": Mutant(
        "sim/spacecraft/sensors/sun_sensor.py",
        "noise_rad=float(np.radians(self.noise_deg)),\n            mis",
        "noise_rad=float(self.noise_deg),\n            mis",
        CHAIN,
    ),
    "scanner's noise x 2": Mutant(
        "sim/spacecraft/sensors/horizon_scanner.py",
        "0.0 if correlated else float(np.radians(self",
        "0.0 if correlated else 2.0 * float(np.radians(self",
        CHAIN,
    ),
    "scanner's biases exchanged": Mutant(
        "sim/spacecraft/sensors/horizon_scanner.py",
        "radians(self.roll_bias_deg)), float(np.radians(self.pitch_bias_deg))",
        "radians(self.pitch_bias_deg)), float(np.radians(self.roll_bias_deg))",
        "tests/calib/attitude/test_horizon_scanner.py",
    ),
    "gyro's noise in radians": Mutant(
        "sim/spacecraft/sensors/gyro.py", "float(np.radians(self.noise_deg_s))", "float(self.noise_deg_s)", CHAIN
    ),
    "memory of the reference halved": Mutant(
        "sim/attitude/gauss_markov.py", "stamps[0])) / tau_s", "stamps[0])) / (0.5 * tau_s)", CHAIN
    ),
    "orbital frame transposed": Mutant(
        "sim/earth/frames.py", "    y = -normal / size[:, None]\n", "    y = normal / size[:, None]\n", CHAIN
    ),
    "Earth's rotation 1 s late": Mutant(
        "sim/earth/frames.py",
        "erfa.era00(*epoch.jd_ut1(stamps))",
        "erfa.era00(*epoch.jd_ut1(stamps)) + 7.292e-5",
        "tests/sim/earth/test_astropy_witness.py",
    ),
    "Earth 1.2 % smaller in its shadow": Mutant(
        "sim/earth/sun.py",
        "np.arcsin(EARTH_RADIUS_KM /",
        "np.arcsin(6300.0 /",
        "tests/sim/earth/test_sun_and_eclipse.py",
    ),
    "perigee under J2": Mutant(
        "sim/earth/orbit.py", "(5.0 * cos_i**2", "(4.0 * cos_i**2", "tests/sim/earth/test_orbit.py"
    ),
    "leap seconds dropped": Mutant(
        "sim/earth/epoch.py",
        "plain + _leap_seconds(stamps) - _leap",
        "plain + 0.0 * _leap_seconds(stamps) - 0.0 * _leap",
        "tests/sim/earth/test_time.py",
    ),
    "a milligauss is 10 nT": Mutant(
        "sim/earth/constants.py",
        "NT_PER_MG = 100.0",
        "NT_PER_MG = 10.0",
        "tests/sim/spacecraft/test_magnetometer.py tests/sim/telemetry/test_telemetry_files.py "
        "tests/sim/telemetry/test_layouts.py",
    ),
    "field 1 % too strong": Mutant(
        "sim/earth/field_kernels.py",
        "s = FIELD_RADIUS_KM / (",
        "s = 1.0033 * FIELD_RADIUS_KM / (",
        "tests/sim/earth/test_field_peers.py",
    ),
    "coupling of torquers transposed": Mutant(
        "sim/spacecraft/torquers.py",
        "dipole_field_nT(np.eye(3), positions_B_m).T",
        "dipole_field_nT(np.eye(3), positions_B_m)",
        "tests/sim/spacecraft/test_magnetometer.py",
    ),
    "yaw: sign of the solution": Mutant(
        "calib/attitude/yaw.py",
        "b0[:, 1] * c[:, 0] - b0[:, 0] * c[:, 1]",
        "b0[:, 0] * c[:, 1] - b0[:, 1] * c[:, 0]",
        "tests/calib/attitude/test_yaw.py",
    ),
    "TWOSTEP's published noise term": Mutant(
        "calib/scalar/twostep.py",
        "(1.0 if published else -1.0)",
        "1.0",
        "tests/calib/scalar/test_recovery.py tests/calib/scalar/test_properties.py",
    ),
    "white covariance halved": Mutant(
        "calib/common/covariance.py",
        "        score = (r[:, None, :] * z",
        "        score = (0.7 * r[:, None, :] * z",
        SIGMAS,
    ),
    "correlated covariance x 0.6": Mutant(
        "calib/linear/covariance_report.py",
        "bread_of(solution.fit, problem.noise_xx)) / sharpness\n",
        "bread_of(solution.fit, problem.noise_xx)) / sharpness * 0.6\n",
        SIGMAS,
    ),
    "scalar covariance halved": Mutant(
        "calib/scalar/covariance.py",
        "meat = scores.rows.T @ scores.rows",
        "meat = 0.5 * scores.rows.T @ scores.rows",
        "tests/calib/scalar/test_recovery.py",
    ),
}


def main() -> int:
    """Make the mutants one by one and say which the tests notice; 1 if one was missed."""
    options = _options()
    for mutant in MUTANTS.values():  # all of them, before anything takes time
        if (count := (ROOT / mutant.file).read_text(encoding="utf-8").count(mutant.right)) != 1:
            raise SystemExit(f"{mutant.file}: {mutant.right!r} stands there {count} times, and is to stand there once")
    names = options.only or (list(MUTANTS)[:1] if options.quick else list(MUTANTS))
    caught = 0
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "fluxtwin"
        ignored = shutil.ignore_patterns(".git", ".types", "build", "__pycache__", "*-results", ".venv")
        shutil.copytree(ROOT, copy, ignore=ignored)
        subprocess.run([sys.executable, ".ci/link_types.py"], cwd=copy, check=True, capture_output=True)
        sound = sorted({MUTANTS[name].tests for name in names})
        print(f"{'mutant':34s} {'noticed by':44s} {'s':>5s}", flush=True)
        for tests in sound:
            if not _passes(copy, tests):
                raise SystemExit(f"{tests}: does not pass as it is, so it tells nothing")
        for name in names:
            begin = time.perf_counter()
            noticed = _noticed(copy, MUTANTS[name])
            caught += noticed
            where = MUTANTS[name].tests.split()[0].rsplit("/", 1)[-1] if noticed else "NOBODY"
            print(f"{name:34s} {where:44s} {time.perf_counter() - begin:5.0f}", flush=True)
    print(f"{caught} of {len(names)}")
    return 0 if caught == len(names) else 1


def _noticed(copy: Path, mutant: Mutant) -> bool:
    """Whether the mutant's tests fail with it."""
    path = copy / mutant.file
    sound = path.read_text(encoding="utf-8")
    path.write_text(sound.replace(mutant.right, mutant.wrong), encoding="utf-8")
    try:
        return not _passes(copy, mutant.tests)
    finally:
        path.write_text(sound, encoding="utf-8")


def _passes(copy: Path, tests: str) -> bool:
    """Whether these tests pass in the copy, whose own code is imported in place of what is installed."""
    environment = {**os.environ, "PYTHONPATH": str(copy / ".types"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.setdefault("FLUXTWIN_SHARED", str(ROOT.parent / "shared"))
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests.split()]
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{tests}: pytest ended with {done.returncode}\n{done.stdout[-2000:]}")
    return done.returncode == 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=list(MUTANTS), help="repeatable")
    parser.add_argument("--quick", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
