"""The metrics of online identification; `metric_catalogue` lists them with the rest."""

from benchmarks.metrics.metric import Metric, yardstick

IDENTIFICATION = (
    Metric(
        "friction_error_worst_pct",
        "error of the shaft friction of a layer at its rupture, worst layer, as known at the end",
        tolerance=0.5,
    ),
    Metric("friction_error_mean_pct", "the same, mean over layers", tolerance=0.5),
    Metric(
        "friction_coverage_2sigma",
        "share of layers whose friction lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        "friction_error_online_worst_pct",
        "error of that friction as identified in the layer after it, worst layer",
        tolerance=0.5,
    ),
    Metric("friction_error_online_mean_pct", "the same, mean over layers", tolerance=0.5),
    Metric(
        "friction_coverage_online_2sigma",
        "share of layers within twice the standard deviation stated there",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        "exit_residue_pct",
        "mean |enhanced force| after the last exit, of the uncompensated force there",
        tolerance=0.5,
    ),
    Metric(
        "enhanced_rmse_N",
        "rms error of the enhanced force from the first compensation to the deepest point",
        tolerance=2e-3,
    ),
    Metric("tip_rmse_N", "rms error of the tip force over the same time", tolerance=2e-3),
    Metric(
        "rupture_recall",
        "share of true ruptures that were reported",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        "rupture_precision",
        "share of reported ruptures that are true",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        "soft_transition_recall",
        "share reported of true transitions whose force drop is below five times the noise",
        best=1.0,
        tolerance=1e-3,
    ),
    Metric("rupture_delay_ms", "alarm after the onset of the release, median", tolerance=2.0),
    Metric(
        "rupture_dating_error_ms",
        "error of the estimated instant of rupture, median",
        tolerance=2.0,
    ),
    Metric(
        "rupture_overshoot_mm",
        "travel of the tip from the onset of the release to the alarm, median",
        tolerance=5e-3,
    ),
)
"""Of a simulated insertion; one column each in the table of identification."""

BOUNDS = (
    yardstick(
        "friction_bound_pct",
        "least mean error of the friction of a layer that the noise allows (Cramér-Rao)",
    ),
    yardstick("friction_bound_white_pct", "the same, were noise of that size white"),
    yardstick(
        "rupture_delay_bound_ms",
        "least mean delay at one false alarm an hour (Lorden), median over ruptures",
    ),
)
"""What a simulated insertion and its noise would have allowed; no property of a method."""

TABLE_I = (
    yardstick("cumulative_friction_true_Ns_per_m", "B d of a single gel, true"),
    yardstick("cumulative_friction_offline_Ns_per_m", "B d of a single gel, identified offline"),
    yardstick("cumulative_friction_online_Ns_per_m", "B d of a single gel, identified online"),
)
"""Figures to lay beside the paper's Table I; how good they are, `friction_error_*` tells."""

OFFLINE = tuple(
    Metric(
        f"offline_rmse_{model}_N",
        f"rms of what the {text} model leaves of an insertion, fitted offline",
        tolerance=2e-3,
    )
    for model, text in (("ml", "multi-layer"), ("kv", "Kelvin-Voigt"))
)
"""The models themselves, as in Figures 2 and 3: nothing online enters."""

REAL_TISSUE = (
    *(
        Metric(
            f"pullout_error{where}_{name}_pct",
            f"friction told{text} against the pull-out force, {which}",
            tolerance=0.5,
        )
        for where, text in (
            ("", " at 42 and 78 mm"),
            ("_42mm", " at 42 mm"),
            ("_78mm", " at 78 mm"),
        )
        for name, which in (("median", "median"), ("p90", "90th percentile"))
    ),
    yardstick("ruptures_per_insertion", "ruptures reported per insertion"),
    yardstick(
        "falls_per_insertion",
        "falls of the force by 0.15 N within 2 mm, found offline, per insertion",
    ),
    Metric("fall_recall", "share of these falls with an alarm", best=1.0, tolerance=0.02),
    Metric(
        "ruptures_at_falls",
        "share of alarms where the force falls by five times its noise",
        best=1.0,
        tolerance=0.02,
    ),
    Metric(
        "enhanced_against_ft_rmse_N",
        "rms difference of the enhanced force from that told by the same method on F/T",
        tolerance=0.02,
    ),
    Metric("ruptures_missed", "annotated ruptures without an alarm"),
    Metric("ruptures_false", "alarms without an annotated rupture"),
    Metric("ruptures_without_fall", "alarms where the force does not fall by five times its noise"),
    Metric(
        "rupture_depth_error_mm",
        "worst distance of the alarm from the annotated depth",
        tolerance=0.05,
    ),
    Metric(
        "rupture_dated_depth_error_mm",
        "worst distance of the estimated depth of rupture from the annotated one",
        tolerance=0.05,
    ),
)
"""Of recordings of real tissue."""

LIVER_LIMIT = (
    *(
        yardstick(
            f"pullout_left_out_{name}_{share}_pct",
            f"pull-out force of an unseen insertion from {text}, {which}",
        )
        for name, text in (
            ("depth", "depth alone"),
            ("force", "depth and force"),
            ("told", "depth and friction told"),
            ("few", "the best features"),
            ("ridge", "all features, ridge"),
            ("gp_few", "the best features, Gaussian process"),
            ("gp", "all features, Gaussian process"),
        )
        for share, which in (("median", "median error"), ("p90", "90th percentile"))
    ),
    yardstick(
        "pullout_above_insertion_share",
        "share of insertions whose pull-out force at 20 mm exceeds all of the insertion's",
    ),
    yardstick(
        "pullout_over_insertion_most",
        "largest pull-out force at 20 mm as a share of the insertion force there",
    ),
    *(
        yardstick(f"pullout_{name}_{share}_pct", f"{text}, {which}")
        for name, text in (
            ("shallower_peak", "largest pull-out force at 60 to 78 mm above that at 78 mm"),
            ("neighbour", "difference of the pull-out force from the next insertion's"),
        )
        for share, which in (("median", "median"), ("p90", "90th percentile"))
    ),
)
"""Of real liver itself: what could be known, and how far its yardstick is to be trusted."""
