"""Time and memory of a CT at full size, in a fresh process.

The scan has 88 million voxels and 61 structures. The structures are those of the real
CT, four times as fine.
"""

import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks import BenchmarkCode, BenchmarkError, DataError
from benchmarks.anatomy.study import CT_FOLDER
from benchmarks.jobs import Progress
from benchmarks.results import Measurement, our_measurement
from needleforce.anatomy import read_labels

FINER = 4
"""Voxels of the judged scan in one of the recorded scan's."""


def measure(seed: int, data: Path | None, progress: Progress) -> Iterator[Measurement]:
    """Yield time, memory and what the surfaces are like."""
    del seed  # nothing is drawn
    if data is None:
        raise DataError("anatomy-fullsize needs the recordings")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "labels.nrrd"
        voxels = _write_finer(data / CT_FOLDER / "labels.nii.gz", path)
        command = [sys.executable, "-m", "benchmarks.anatomy.fullsize", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            lines = []
            for line in child.stdout or ():
                lines.append(line.split())
                if len(lines[-1]) == 1:
                    progress(float(line))
        if child.returncode:
            raise BenchmarkError(
                f"reading the full-size volume ended with {child.returncode}",
                BenchmarkCode.RUN,
            )
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
        yield our_measurement(metric, value, "CT, finer")


def _write_finer(source: Path, path: Path) -> int:
    """Write the labels with smaller voxels; return how many there are.

    Boundaries are those of each mask by linear interpolation.
    """
    import SimpleITK
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
    image = SimpleITK.GetImageFromArray(values.T)
    image.SetSpacing((1e3 * labels.grid.spacing_m / FINER).tolist())
    SimpleITK.WriteImage(image, str(path), useCompression=True)
    return values.size


def _run(path: Path) -> None:
    """Read and mesh in this process.

    Writes fractions done, then the results in one line.
    """
    begin = perf_counter()
    labels = read_labels(path)
    surfaces = labels.surfaces(progress=lambda fraction: _say(f"{fraction:.4f}"))
    seconds = perf_counter() - begin
    gigabytes = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9
    ratios = [
        surface.mesh.volume / (labels[name].voxels * labels.grid.voxel_m3)
        for name, surface in surfaces.items()
    ]
    closed = sum(surface.mesh.is_volume for surface in surfaces.values())
    worst = 100.0 * max(abs(ratio - 1.0) for ratio in ratios)
    triangles = sum(len(surface.triangles) for surface in surfaces.values())
    _say(f"{seconds} {gigabytes} {len(surfaces)} {closed} {worst} {triangles}")


def _say(line: str) -> None:
    """Write a line to whoever started this process."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _run(Path(sys.argv[1]))
