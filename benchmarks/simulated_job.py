"""A job on the simulated arm, from its name to its numbers and its picture."""

from benchmarks.benchmark import Findings
from benchmarks.job import Job, Progress
from benchmarks.simulated import scenario_of, simulated_case, simulated_metrics


def run_simulated(job: Job, progress: Progress) -> Findings:
    """Simulate, read every sensor, measure, draw."""
    case = simulated_case(job, scenario_of(job), progress)
    picture = job.picture()
    if picture is not None:
        # Lazily: without --report nobody waits for matplotlib.
        from benchmarks.force_figure import save_force_figure

        title = f"{case.run.scenario.title} ({job.plant} arm, seed {job.seed})"
        save_force_figure(picture, title, case.truth, case.readings)
    return Findings(simulated_metrics(case), picture)
