"""A loop at 1 kHz with the whole session, fed by the emulated controller of an LWR.

The controller is a process of its own; each of its cycles is answered, then estimated.
The wake-up is late by what a sample arrives after its place on a grid of 1 ms, whose
beginning is that of the sample least late. An overrun is a tick that takes longer than
a cycle. Real-time priority is taken where the system grants it.
"""

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, perf_counter_ns
from typing import Any

import numpy as np
import psutil

from benchmarks.jobs import Job, Progress, progress_part
from benchmarks.results import Figure
from groundtruth import Run, simulate
from needleforce import InsertionSession
from needleforce.devices import ArmReading, FriArm, LinkError
from needleforce.devices.emulators import Emulator, FriSettings, emulate_fri
from needleforce.devices.emulators.process import take_real_time
from needleforce.recorder import Recorder, leave_real_time
from urdf import Robot

WARM_UP = 2000
"""Cycles before which nothing is counted: what is compiled or loaded late."""
ALONE = "alone"
SCENE = "with the scene"
RECORDER = "with a recorder"
CASES = tuple(f"60 s {kind}" for kind in (ALONE, SCENE, RECORDER))


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Run the loop for the seconds of the case, alone or beside something."""
    seconds, _, kind = job.case.split(" ", 2)
    insertion = simulate("gel-25-constant", "fri", 0, progress_part(progress, 0.0, 0.2))
    yield from run_loop(insertion, float(seconds), kind)
    progress(1.0)


@contextmanager
def _beside(
    kind: str, robot: Robot, found: dict[str, float]
) -> Iterator[Callable[[Any, ArmReading], None]]:
    """Yield what takes the estimate and the sample of every tick.

    At the end it adds what else was found.
    """
    if kind == SCENE:
        from needleforce.scene import open_viewer

        context = multiprocessing.get_context("spawn")
        pids_before = {child.pid for child in psutil.Process().children()}
        with open_viewer(robot) as view:
            pages = {child.pid for child in psutil.Process().children()} - pids_before
            pipe, other = context.Pipe()
            arguments = (other, view.url, sorted(pages))
            context.Process(target=_watch, args=arguments, daemon=True).start()
            yield lambda now, sample: view.put(now, sample.q_rad)
            pipe.send("stop")
            found["scene_updates_Hz"], found["scene_processor_pct"] = pipe.recv()
    elif kind == RECORDER:
        names = robot.joint_names
        with (
            TemporaryDirectory() as at,
            Recorder(Path(at) / "loop.mcap", names) as recorder,
        ):
            yield lambda _, sample: recorder.put(sample)
    else:
        yield lambda *_: None


def _watch(pipe: Connection, url: str, pids: list[int]) -> None:
    """Count the updates that reach a page, and its server's processor time.

    This is the process of the page's reader.
    """
    import viser
    import zstandard
    from websockets.sync.client import connect

    leave_real_time()
    kind: Any = f"viser-v{viser.__version__}"
    servers = [psutil.Process(pid) for pid in pids]

    def used_s() -> float:
        return sum(sum(server.cpu_times()[:2]) for server in servers)

    with connect(url.replace("http", "ws"), subprotocols=[kind], max_size=None) as page:
        updates = 0
        begin_s = 0.0
        before_s = 0.0
        while not pipe.poll():
            try:
                message: Any = page.recv(timeout=0.1)
            except TimeoutError:
                continue
            packed = message[16 : 16 + int.from_bytes(message[8:16], "little")]
            if b"tip force" not in zstandard.decompress(
                packed, max_output_size=1 << 28
            ):
                continue
            updates += 1
            if updates == 1:  # what came before it was the whole scene
                begin_s = perf_counter()
                before_s = used_s()
        passed_s = perf_counter() - begin_s
        pipe.send(((updates - 1) / passed_s, 100.0 * (used_s() - before_s) / passed_s))


def run_loop(run: Run, seconds: float, kind: str) -> Iterator[Figure]:
    """Run the loop once, beside what its kind says."""
    beside: dict[str, float] = {}
    signals = run.signals
    cycles = round(1e3 * seconds) + WARM_UP
    arm = FriArm(port=0, give_up_s=0.5)
    session = InsertionSession(run.robot)
    settings = FriSettings(
        port=arm.address[1],
        q_rad=signals.q_rad,
        tau_Nm=signals.tau_Nm,
        cycles=cycles,
        in_real_time=True,
    )
    arrived_us = list[float]()
    taken_us = list[float]()
    with ExitStack() as stack:
        stack.enter_context(arm)
        put = stack.enter_context(_beside(kind, run.robot, beside))
        controller = stack.enter_context(Emulator(emulate_fri, settings))
        is_real_time = take_real_time()
        with suppress(LinkError):  # the emulator has ended
            for sample in arm:
                begin_ns = perf_counter_ns()
                tau = sample.tau_Nm
                assert tau is not None  # an LWR sends it
                estimate = session.update(sample.q_rad, None, tau, sample.dt_s)
                put(estimate, sample)
                arrived_us.append(begin_ns / 1e3)
                taken_us.append((perf_counter_ns() - begin_ns) / 1e3)
        leave_real_time()
        counts = controller.counts()
    tick_us = np.array(taken_us[WARM_UP:])
    since_us = np.array(arrived_us[WARM_UP:])
    late_us = since_us - 1e3 * np.arange(len(since_us))
    for what, values in (("tick", tick_us), ("wake-up", late_us - late_us.min())):
        name = f"{what}, {kind}"
        yield Figure("loop_p50_us", np.percentile(values, 50.0), name)
        yield Figure("loop_p99_us", np.percentile(values, 99.0), name)
        yield Figure("loop_p999_us", np.percentile(values, 99.9), name)
        yield Figure("loop_most_us", values.max(), name)
    name = f"tick, {kind}"
    yield Figure("loop_overruns", np.count_nonzero(tick_us > 1000.0), name)
    yield Figure("loop_missed", arm.report.missed, name)
    answered_pct = 100.0 * counts["same_cycle"] / counts["cycles"]
    yield Figure("loop_answered_pct", answered_pct, name)
    yield Figure("loop_is_real_time", is_real_time, name)
    yield from (Figure(metric, value, name) for metric, value in beside.items())
