"""Time and memory of a CT at full size, each in a fresh process.

The scan has 88 million voxels and 61 structures. The structures are those of the real
CT, four times as fine; so is the scan, with noise. All surfaces are made, and a path to
the liver is planned by the command, page and 3-D view included.
"""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from benchmarks import RUN_ALONE, BenchmarkError, DataError
from benchmarks.anatomy import CT_FOLDER
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from needleforce.anatomy import Grid, read_labels, read_volume

FINER = 4
"""Voxels of the judged scan along an edge of one of the recorded scan's."""

NOISE_HU = 12.0
"""Of the judged scan's voxels: without it there would be hardly any fat in lean."""

BYTES_PER_KB = 1024.0
"""The system counts memory in these."""

TARGET = "liver"
"""Of the planned path."""


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield time and memory of surfaces and plan, and what the surfaces are like."""
    if job.data is None:
        raise DataError("anatomy-fullsize needs the recordings")
    with TemporaryDirectory() as folder:
        labels = Path(folder) / "labels.nii.gz"
        voxels = _write_finer(job.data / CT_FOLDER / "labels.nii.gz", labels)
        yield from _measure_surfaces(labels, voxels, progress)
        scan = Path(folder) / "ct.nii.gz"
        rng = np.random.default_rng(job.seed)
        _write_finer_scan(job.data / CT_FOLDER / "ct.nii.gz", scan, rng)
        names = (job.data / CT_FOLDER / "labels.json").read_bytes()
        (Path(folder) / "labels.json").write_bytes(names)
        yield from _measure_plan(Path(folder))
    progress(1.0)


def _measure_surfaces(path: Path, voxels: int, progress: Progress) -> Iterator[Figure]:
    """Measure how long it takes to read labels and to make all surfaces."""
    command = [sys.executable, "-m", "benchmarks.anatomy.fullsize", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        lines = []
        for line in child.stdout or ():
            lines.append(line.split())
            if len(lines[-1]) == 1:
                progress(0.7 * float(line))
    _require_success("reading the full-size volume", child.returncode)
    seconds, gigabytes, structures, closed, worst, triangles = map(float, lines[-1])
    values = {
        "voxels": voxels,
        "structures": structures,
        "surfaces_time_s": seconds,
        "surfaces_memory_GB": gigabytes,
        "watertight_pct": 100.0 * closed / structures,
        "voxel_volume_error_max_pct": worst,
        "triangles": triangles,
    }
    for metric, value in values.items():
        yield Figure(metric, value, "CT, finer")


def _measure_plan(folder: Path) -> Iterator[Figure]:
    """Measure how long the command `plan` takes, from its start to its last file."""
    command = [sys.executable, "-m", "benchmarks.anatomy.fullsize", "plan"]
    command += ["--target", TARGET, "--ct", str(folder / "ct.nii.gz")]
    command += ["--labels", str(folder / "labels.nii.gz"), "-o", str(folder / "plan")]
    begin = perf_counter()
    child = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    seconds = perf_counter() - begin
    _require_success("needleforce plan", child.returncode)
    processor_s, gigabytes = map(float, child.stdout.splitlines()[-1].split())
    values = {
        "plan_time_s": seconds,
        "plan_processor_time_s": processor_s,
        "plan_memory_GB": gigabytes,
    }
    for metric, value in values.items():
        yield Figure(metric, value, "CT, finer")


def _require_success(work: str, code: int) -> None:
    """Refuse the figures of a process that failed."""
    if code:
        raise BenchmarkError(f"{work} ended with {code}", RUN_ALONE)


def _write_finer(source: Path, path: Path) -> int:
    """Write the labels with smaller voxels; return how many there are.

    Boundaries are those of each mask by linear interpolation.
    """
    from scipy.ndimage import zoom

    labels = read_labels(source)
    values = np.zeros([FINER * size for size in labels.grid.shape], np.uint8)
    for item in labels.structures:
        mask = np.pad(labels.mask(item.name), 1).astype(np.float32)
        fine = zoom(mask, FINER, order=1, grid_mode=True, mode="nearest")[
            (slice(FINER, -FINER),) * 3
        ]
        box = tuple(slice(FINER * span.start, FINER * span.stop) for span in item.box)
        values[box][fine > 0.5] = item.value
    _write_image(values, labels.grid, path)
    return values.size


def _write_finer_scan(source: Path, path: Path, rng: np.random.Generator) -> None:
    """Write the scan with smaller voxels: between those of the source, with noise."""
    from scipy.ndimage import zoom

    scan = read_volume(source)
    coarse_HU = scan.values.astype(np.float32)
    fine_HU: NDArray[np.float32] = np.zeros(
        [FINER * size for size in coarse_HU.shape], np.float32
    )
    zoom(coarse_HU, FINER, fine_HU, order=1, grid_mode=True, mode="nearest")
    for section in fine_HU:
        section += NOISE_HU * rng.standard_normal(section.shape, np.float32)
    _write_image(np.rint(fine_HU).astype(np.int16), scan.grid, path)


def _write_image(values: NDArray[np.integer], coarse: Grid, path: Path) -> None:
    """Write voxels that are finer than those of a grid, and lie where these do."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(values.T))
    corner_m = coarse.points_m(np.full(3, 0.5 / FINER - 0.5))
    directions = coarse.axes_m / coarse.spacing_m
    image.SetOrigin((1e3 * corner_m).tolist())
    image.SetDirection(directions.ravel().tolist())
    image.SetSpacing((1e3 * coarse.spacing_m / FINER).tolist())
    SimpleITK.WriteImage(image, str(path), useCompression=True)


def _run_surfaces(path: Path) -> None:
    """Read and mesh in this process.

    Writes fractions done, then the results in one line.
    """
    begin = perf_counter()
    labels = read_labels(path)
    surfaces = labels.surfaces(progress=lambda fraction: _say(f"{fraction:.4f}"))
    seconds = perf_counter() - begin
    gigabytes = _peak_memory_GB()
    ratios = [
        surface.mesh.volume / (labels[name].voxels * labels.grid.voxel_m3)
        for name, surface in surfaces.items()
    ]
    closed = sum(surface.mesh.is_volume for surface in surfaces.values())
    worst = 100.0 * max(abs(ratio - 1.0) for ratio in ratios)
    triangles = sum(len(surface.triangles) for surface in surfaces.values())
    _say(f"{seconds} {gigabytes} {len(surfaces)} {closed} {worst} {triangles}")


def _run_plan(arguments: list[str]) -> None:
    """Run the command in this process; write processor time and memory in one line."""
    from needleforce.cli import main

    code = main(arguments)
    _say(f"{process_time()} {_peak_memory_GB()}")
    sys.exit(code)


def _peak_memory_GB() -> float:
    """Return the largest memory of this program.

    What the system says of a process would count the one that started it, too.
    """
    status = Path("/proc/self/status").read_text()
    lines = dict(line.split(":", 1) for line in status.splitlines())
    return BYTES_PER_KB * float(lines["VmHWM"].split()[0]) / 1e9


def _say(line: str) -> None:
    """Write a line to whoever started this process."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    if sys.argv[1] == "plan":
        _run_plan(sys.argv[1:])
    else:
        _run_surfaces(Path(sys.argv[1]))
