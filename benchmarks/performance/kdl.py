"""The same samples through orocos KDL's estimator of a wrench: the time of an update.

``ChainExternalWrenchEstimator`` is what a user finds in Debian (``liborocos-kdl-dev``).
It gets the robot, the gain and the samples that ours gets; its inner filter is off, as
ours has none. It takes no offset off and has no tare.
"""

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from benchmarks import BenchmarkError
from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Figure, Job
from benchmarks.performance import ticks
from benchmarks.performance.ticks import Update, cost_ratio
from foundation.arrays import Array
from groundtruth import Run, simulate
from residual import DEFAULT, PUBLISHED, MomentumObserver, VirtualForceSensor
from residual.wrench_estimator import (
    WrenchEstimator,
    WrenchFilterState,
)
from urdf import Robot

KDL = "KDL"
BARE = "KDL, addresses known in advance"
OURS = "ours, observer and wrench"
SENSOR = "ours, virtual sensor"


class KdlAbsentError(BenchmarkError):
    """The library, its headers or a compiler is missing."""


def kdl_library() -> ctypes.CDLL:
    """Compile and load KDL's estimator behind `kdl_shim.cpp`.

    Raises:
        KdlAbsentError: It cannot be compiled.
    """
    source = Path(__file__).with_name("kdl_shim.cpp")
    with TemporaryDirectory() as folder:  # what is loaded stays when the file goes
        compiled = Path(folder) / "kdl_shim.so"
        command = [
            "g++",
            "-O2",
            "-shared",
            "-fPIC",
            "-I/usr/include/eigen3",
            source,
            "-o",
            compiled,
        ]
        try:
            subprocess.run([*command, "-lorocos-kdl"], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError) as error:
            packages = "g++ and Debian's liborocos-kdl-dev"
            raise KdlAbsentError(
                f"no comparison with KDL: it needs {packages}", f"Install {packages}"
            ) from error
        library = ctypes.CDLL(str(compiled))
    library.kdl_new.restype = ctypes.c_void_p
    for name, count in (("kdl_delete", 1), ("kdl_start", 3), ("kdl_update", 5)):
        getattr(library, name).argtypes = [ctypes.c_void_p] * count
    return library


def chain_numbers(robot: Robot) -> Array:
    """Return a serial arm as `kdl_shim.cpp` takes it, shape (n + 1, 26).

    Its joints turn.
    """
    model = robot.model
    data = robot.create_data()
    at_zero = pin.neutral(robot.model)
    rows = []
    for k in range(1, model.njoints):
        place = model.jointPlacements[k]
        body = model.inertias[k]
        turn = pin.computeJointJacobian(model, data, at_zero, k)[3:, k - 1]
        inertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        frame = (place.rotation.ravel(), place.translation, place.rotation @ turn)
        rows.append(
            np.concatenate(
                (*frame, [body.mass], body.lever, inertia, [model.armature[k - 1]])
            )
        )
    tool = model.frames[robot.tool_frame_id].placement
    rows.append(np.concatenate((tool.rotation.ravel(), tool.translation, np.zeros(14))))
    return np.array(rows)


class KdlEstimator:
    """KDL's estimator of one robot.

    Args:
        library: From `kdl_library`.
        robot: The arm with its payload.
        signals: The n samples it will get.
        gain_per_s: K [1/s].
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        robot: Robot,
        signals: JointSignals,
        gain_per_s: float,
    ) -> None:
        numbers = chain_numbers(robot)
        self._library = library
        gravity = np.array(robot.gravity_m_s2)
        rate_hz = 1.0 / float(np.median(signals.dt_s))
        settings = map(ctypes.c_double, (rate_hz, gain_per_s, 0.0))
        arrays = (array.ctypes.data_as(ctypes.c_void_p) for array in (numbers, gravity))
        self._handle = ctypes.c_void_p(
            library.kdl_new(len(numbers), *arrays, *settings)
        )
        assert signals.dq_rad_s is not None, "KDL needs velocities"
        sent = map(
            np.ascontiguousarray, (signals.q_rad, signals.dq_rad_s, signals.tau_Nm)
        )
        self._samples = list(zip(*sent, strict=True))
        self._wrench = np.zeros(6)  # on the tool frame, in its axes
        self._into = self._wrench.ctypes.data
        library.kdl_start(
            self._handle, *(array.ctypes.data for array in self._samples[0][:2])
        )

    def __call__(self, k: int) -> None:
        """Take sample k."""
        q, dq, tau = self._samples[k]
        self.call(q.ctypes.data, dq.ctypes.data, tau.ctypes.data)

    def bare(self) -> Update:
        """Return what takes sample k where its addresses are known in advance."""
        places = [
            tuple(array.ctypes.data for array in sample) for sample in self._samples
        ]
        return lambda k: self.call(*places[k])

    def call(self, q: int, dq: int, tau: int) -> None:
        """Take a sample by its addresses."""
        if self._library.kdl_update(self._handle, q, dq, tau, self._into):
            raise BenchmarkError("KDL's estimator refused a sample")

    @property
    def axial_N(self) -> float:
        """Resistance to insertion, along z of the tool frame, at the last sample."""
        return -float(self._wrench[2])

    def __del__(self) -> None:
        self._library.kdl_delete(self._handle)


class PlainEstimator:
    """Our observer and, as KDL's, the pseudo-inverse of all six rows.

    Arguments are those of `KdlEstimator`.

    Attributes:
        axial_N: Resistance to insertion at the last sample.
    """

    def __init__(self, robot: Robot, signals: JointSignals, gain_per_s: float) -> None:
        self._observer = MomentumObserver(robot, gain_per_s, alignment="hold")
        self._wrench = WrenchEstimator(robot, PUBLISHED)
        self._samples = signals.samples()
        self._filter = WrenchFilterState.at_zero(self._wrench.size)
        self.axial_N = 0.0

    def __call__(self, k: int) -> None:
        """Take sample k."""
        q, dq, tau, dt_s = self._samples[k]
        assert dq is not None
        residual = self._observer.update(q, dq, tau, dt_s)
        self._wrench.renew_gain(q)
        self.axial_N = self._wrench.solve(residual, self._filter).axial


def peer_times(run: Run, library: ctypes.CDLL) -> dict[str, Array]:
    """Time of every tick [us] from the tare on, taking turns."""
    signals = JointSignals.of_run(run)
    gain_per_s = DEFAULT.slowest_gain_per_s
    tare = int(np.searchsorted(signals.t_s, run.tare_end_s))
    sensor = VirtualForceSensor(run.robot, on_lwr(DEFAULT))
    subjects = {
        KDL: KdlEstimator(library, run.robot, signals, gain_per_s),
        BARE: KdlEstimator(library, run.robot, signals, gain_per_s).bare(),
        OURS: PlainEstimator(run.robot, signals, gain_per_s),
        SENSOR: ticks.fed(sensor, signals, tare),
    }
    return ticks.time_side_by_side(subjects, tare + 1, len(signals.t_s))


def run(job: Job) -> Iterator[Figure]:
    """Compare the time of all estimators, each with KDL's."""
    times = peer_times(simulate(ticks.SCENARIO, ticks.PLANT, job.seed), kdl_library())
    for name, taken_us in times.items():
        yield Figure("kdl_tick_median_us", np.median(taken_us), name)
        yield Figure("kdl_tick_ratio", cost_ratio(taken_us, times[KDL]), name)
