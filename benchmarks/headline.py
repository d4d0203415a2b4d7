"""The gate: what a stranger sees of this toolkit, beside what it was.

`judged.toml` says which numbers of insertions are kept; those of time are here.
"""

import json
import math
from collections.abc import Callable
from ctypes import CDLL
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from time import thread_time_ns

import numpy as np
import pandas as pd

from benchmarks import ResultsError
from benchmarks.campaign import find_commit
from benchmarks.catalogue import make_jobs
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Job
from benchmarks.judging import KEPT_FIGURES, METRICS, compare, select, sum_up, unit_of
from benchmarks.performance import control, kdl, ticks
from benchmarks.performance.ticks import Update, cost_ratio
from foundation.arrays import Array
from groundtruth import Run, simulate

HEADLINE_FILE = Path(__file__).with_name("headline.json")
SCENARIOS = (
    "gel-25-constant",
    "gel-50-constant",
    "gel-70-constant",
    "stack-constant",
)
PLANTS = ("clean", "fri")
SEED = 1000
OF_PINOCCHIO = "x Pinocchio"
OF_KDL = "x KDL"
"""Units of a ratio of time."""
COLUMNS = ("value", "unit", "best", "tolerance", "relative_tolerance")
"""Of a frame of figures; its index is the figure's name, for people."""


def plan_insertions() -> list[Job]:
    """Return the insertions of the gate."""
    jobs = make_jobs(SCENARIOS, PLANTS, first_seed=SEED)
    return [replace(job, is_ours_only=True) for job in jobs]


def insertion_figures(results: pd.DataFrame) -> pd.DataFrame:
    """Return the kept figures of insertions by plant and source, with `COLUMNS`.

    One that an insertion lacks, as the delay where no rupture was found, is no number.
    """
    ours = results[(results["method"] == "ours") & (results["seed"] == SEED)]
    rows = {}
    for plant in PLANTS:
        for source in ("ft", "virtual"):
            for kept in KEPT_FIGURES:
                if source not in kept.sources:
                    continue
                chosen = select(ours, plant=plant, source=source, metric=kept.metric)
                by_scenario = chosen.set_index("scenario")["value"]
                values = by_scenario.reindex(list(SCENARIOS))
                rows[f"{plant}, {source}: {kept.what}"] = (
                    sum_up(values, kept.statistic, values.abs()),
                    unit_of(kept.metric),
                    METRICS[kept.metric].best,
                    kept.tolerance,
                    kept.relative_tolerance,
                )
    return pd.DataFrame.from_dict(rows, "index", columns=list(COLUMNS))


def measure_times(library: CDLL | None) -> pd.DataFrame:
    """Time everything beside its yardstick, one after the other, in this process.

    Nothing else should run meanwhile. Without KDL there are no figures `OF_KDL`.
    """
    run = simulate(ticks.SCENARIO, ticks.PLANT, SEED)
    ratios = {OF_PINOCCHIO: time_estimators(run) | time_control()}
    if library is not None:
        taken = kdl.peer_times(run, library)
        peers = {kdl.OURS: "observer and wrench", kdl.SENSOR: "sensor"}
        ratios[OF_KDL] = {
            what: cost_ratio(taken[name], taken[kdl.KDL])
            for name, what in peers.items()
        }
    rows = {
        f"time: {what}": (ratio, unit, 0.0, 0.0, 0.15)
        for unit, of_unit in ratios.items()
        for what, ratio in of_unit.items()
    }
    return pd.DataFrame.from_dict(rows, "index", columns=list(COLUMNS))


def take_fastest(measure: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """Measure times by subject three times; return the least of each.

    Other processes only add time.
    """
    passes = [measure() for _ in range(3)]
    return {
        name: np.min([times[name] for times in passes], axis=0) for name in passes[0]
    }


def time_estimators(run: Run) -> dict[str, float]:
    """Return observer, sensor and chains relative to their bare calls."""
    signals = JointSignals.of_run(run)
    # The withdrawal would take as long again, and has no layers to identify.
    end = int(np.searchsorted(signals.t_s, run.scenario.motion.withdrawal_start_s))
    bounds = (ticks.first_counted(run, signals), end)

    def chains() -> dict[str, Update]:
        return ticks.make_chains(run, {"": signals})

    taken = take_fastest(
        lambda: ticks.time_side_by_side(
            ticks.make_estimators(run, signals) | chains(), *bounds
        )
    )
    # Alone, and in processor time: a mean holds whatever else the machine did.
    alone = take_fastest(
        lambda: ticks.time_side_by_side(
            {ticks.CHAIN: chains()[ticks.CHAIN]}, *bounds, thread_time_ns
        )
    )
    bare = ticks.BARE_SENSOR
    mean_ratio = float(np.mean(alone[ticks.CHAIN]) / np.mean(taken[bare]))
    medians = {
        f"{name}, median": cost_ratio(taken[name], taken[of])
        for name, of in (
            (ticks.OBSERVER, ticks.BARE_OBSERVER),
            (ticks.SENSOR, bare),
            (ticks.CHAIN, bare),
            (ticks.PUBLISHED_CHAIN, bare),
        )
    }
    return medians | {f"{ticks.CHAIN}, mean": mean_ratio}


def time_control() -> dict[str, float]:
    """Return ticks of control relative to Jacobian and placement."""
    recorded = control.record_both()
    bounds = (control.WARM_TICKS, round(1e3 * control.SECONDS))
    taken = take_fastest(
        lambda: ticks.time_side_by_side(control.make_control(*recorded), *bounds)
    )
    subjects = {
        control.CONTROL: "RCM tick",
        control.FOLLOWING: "following tick, no RCM",
        control.SATURATED: "RCM tick, limits bind",
    }
    return {
        what: cost_ratio(taken[name], taken[control.BARE])
        for name, what in subjects.items()
    }


def keep_lesser(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """Return the lesser of each time that was measured twice.

    Other processes, and the processor's own clock, only add to a time. One that is no
    number, or was measured once, stays as it is.
    """
    again = second["value"].reindex(first.index)
    return first.assign(value=first["value"].mask(again < first["value"], again))


def compare_figures(
    old: pd.DataFrame, new: pd.DataFrame, absent: str = ""
) -> pd.DataFrame:
    """Compare what was measured with the file, by name, the file's figures first.

    A number that is not to be had is worse, whatever the file says.

    Args:
        old: Of the file, with the tolerances that count.
        new: As measured.
        absent: Unit of figures that cannot be measured here; they are left out.
    """
    earlier = old[old["unit"] != absent]
    later = new[new["unit"] != absent]
    added = later[~later.index.isin(earlier.index)]
    kinds = pd.concat([earlier, added]).assign(undefined=False)
    measured = later["value"].map(round_figure)
    return compare(earlier["value"], measured, kinds).join(kinds["unit"])


def round_figure(value: float) -> float:
    """Return a number with the six digits that the file has; more are rounding."""
    return float(f"{value:.6g}")


def read_headline(path: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    """Read a file of figures, and the commit and versions they were measured with.

    Raises:
        ResultsError: It cannot be read, or is no such file.
    """
    try:
        content = json.loads(path.read_bytes())
        figures = pd.DataFrame(content["figures"]).set_index("name")[list(COLUMNS)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultsError(
            f"{path} is no file of figures: {error}",
            "Write it anew: python -m benchmarks headline --write",
        ) from error
    about = {"commit": content["commit"]} | content["versions"]
    return figures.astype({"value": float}), about


def describe_code() -> dict[str, str]:
    """Return the commit, and versions of libraries that change rounding or time."""
    versions = {name: version(name) for name in ("numpy", "pin", "numba")}
    return {"commit": find_commit() or "unknown"} | versions


def write_headline(path: Path, figures: pd.DataFrame) -> None:
    """Write figures to a file, one a line, so that a change of one is seen.

    Raises:
        ResultsError: It cannot be written.
    """
    versions = describe_code()
    head = {"schema": 1, "commit": versions.pop("commit"), "versions": versions}
    lines = []
    for row in figures.rename_axis("name").reset_index().to_dict("records"):
        number = round_figure(row["value"])
        row["value"] = number if math.isfinite(number) else None
        lines.append(json.dumps(row, separators=(",", ":")))
    body = ",\n  ".join(lines)
    text = f'{json.dumps(head)[:-1]},\n "figures": [\n  {body}\n]}}\n'
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}") from error
