"""The metrics of online identification; `benchmarks.metric_catalogue` lists them with the rest."""

from benchmarks.metric import Metric

IDENTIFICATION = (
    Metric(
        name="friction_error_worst_pct",
        unit="%",
        meaning="error of the shaft friction of a layer at its rupture, worst layer, as known at "
        "the end",
        tolerance=0.5,
    ),
    Metric(
        name="friction_error_mean_pct",
        unit="%",
        meaning="the same, mean over layers",
        tolerance=0.5,
    ),
    Metric(
        name="friction_coverage_2sigma",
        unit="1",
        meaning="share of layers whose friction lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        name="friction_error_online_worst_pct",
        unit="%",
        meaning="error of that friction as identified in the layer after it, worst layer",
        tolerance=0.5,
    ),
    Metric(
        name="friction_error_online_mean_pct",
        unit="%",
        meaning="the same, mean over layers",
        tolerance=0.5,
    ),
    Metric(
        name="friction_coverage_online_2sigma",
        unit="1",
        meaning="share of layers within twice the standard deviation stated there",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        name="exit_residue_pct",
        unit="%",
        meaning="mean |enhanced force| after the last exit, of the uncompensated force there",
        tolerance=0.5,
    ),
    Metric(
        name="enhanced_rmse_N",
        unit="N",
        meaning="rms error of the enhanced force from the first compensation to the deepest point",
        tolerance=2e-3,
    ),
    Metric(
        name="tip_rmse_N",
        unit="N",
        meaning="rms error of the tip force over the same time",
        tolerance=2e-3,
    ),
    Metric(
        name="rupture_recall",
        unit="1",
        meaning="share of true ruptures that were reported",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        name="rupture_precision",
        unit="1",
        meaning="share of reported ruptures that are true",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        name="soft_transition_recall",
        unit="1",
        meaning="share reported of true transitions whose force drop is below five times the noise",
        best=1.0,
        tolerance=1e-3,
    ),
    Metric(
        name="rupture_delay_ms",
        unit="ms",
        meaning="alarm after the onset of the release, median",
        tolerance=2.0,
    ),
    Metric(
        name="rupture_dating_error_ms",
        unit="ms",
        meaning="error of the estimated instant of rupture, median",
        tolerance=2.0,
    ),
    Metric(
        name="rupture_overshoot_mm",
        unit="mm",
        meaning="travel of the tip from the onset of the release to the alarm, median",
        tolerance=5e-3,
    ),
)
"""Of a simulated insertion; one column each in the table of identification."""

BOUNDS = (
    Metric(
        name="friction_bound_pct",
        unit="%",
        meaning="least mean error of the friction of a layer that the noise allows (Cramér-Rao)",
        relative_tolerance=1.0,
    ),
    Metric(
        name="friction_bound_white_pct",
        unit="%",
        meaning="the same, were noise of that size white",
        relative_tolerance=1.0,
    ),
    Metric(
        name="rupture_delay_bound_ms",
        unit="ms",
        meaning="least mean delay at one false alarm an hour (Lorden), median over ruptures",
        relative_tolerance=1.0,
    ),
)
"""What a simulated insertion and its noise would have allowed; no property of a method."""

TABLE_I = (
    Metric(
        name="cumulative_friction_true_Ns_per_m",
        unit="Ns/m",
        meaning="B d of a single gel, true",
        relative_tolerance=1.0,
    ),
    Metric(
        name="cumulative_friction_offline_Ns_per_m",
        unit="Ns/m",
        meaning="B d of a single gel, identified offline",
        relative_tolerance=1.0,
    ),
    Metric(
        name="cumulative_friction_online_Ns_per_m",
        unit="Ns/m",
        meaning="B d of a single gel, identified online",
        relative_tolerance=1.0,
    ),
)
"""Figures to lay beside the paper's Table I; how good they are, `friction_error_*` tells."""

OFFLINE = tuple(
    Metric(
        name=f"offline_rmse_{model}_N",
        unit="N",
        meaning=f"rms of what the {text} model leaves of an insertion, fitted offline",
        tolerance=2e-3,
    )
    for model, text in (("ml", "multi-layer"), ("kv", "Kelvin-Voigt"))
)
"""The models themselves, as in Figures 2 and 3: nothing online enters."""

REAL_TISSUE = (
    *(
        Metric(
            name=f"pullout_error{where}_{name}_pct",
            unit="%",
            meaning=f"friction told{text} against the pull-out force, {which}",
            tolerance=0.5,
        )
        for where, text in (
            ("", " at 42 and 78 mm"),
            ("_42mm", " at 42 mm"),
            ("_78mm", " at 78 mm"),
        )
        for name, which in (("median", "median"), ("p90", "90th percentile"))
    ),
    Metric(
        name="ruptures_per_insertion",
        unit="1",
        meaning="ruptures reported per insertion",
        relative_tolerance=1.0,
    ),
    Metric(
        name="falls_per_insertion",
        unit="1",
        meaning="falls of the force by 0.15 N within 2 mm, found offline, per insertion",
        relative_tolerance=1.0,
    ),
    Metric(
        name="fall_recall",
        unit="1",
        meaning="share of these falls with an alarm",
        best=1.0,
        tolerance=0.02,
    ),
    Metric(
        name="ruptures_at_falls",
        unit="1",
        meaning="share of alarms where the force falls by five times its noise",
        best=1.0,
        tolerance=0.02,
    ),
    Metric(
        name="enhanced_against_ft_rmse_N",
        unit="N",
        meaning="rms difference of the enhanced force from that told by the same method on F/T",
        tolerance=0.02,
    ),
    Metric(name="ruptures_missed", unit="1", meaning="annotated ruptures without an alarm"),
    Metric(name="ruptures_false", unit="1", meaning="alarms without an annotated rupture"),
    Metric(
        name="ruptures_without_fall",
        unit="1",
        meaning="alarms where the force does not fall by five times its noise",
    ),
    Metric(
        name="rupture_depth_error_mm",
        unit="mm",
        meaning="worst distance of the alarm from the annotated depth",
        tolerance=0.05,
    ),
    Metric(
        name="rupture_dated_depth_error_mm",
        unit="mm",
        meaning="worst distance of the estimated depth of rupture from the annotated one",
        tolerance=0.05,
    ),
)
"""Of recordings of real tissue."""

LIVER_LIMIT = (
    *(
        Metric(
            name=f"pullout_left_out_{name}_{share}_pct",
            unit="%",
            meaning=f"pull-out force of an unseen insertion from {text}, {which}",
            relative_tolerance=1.0,
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
    Metric(
        name="pullout_above_insertion_share",
        unit="1",
        meaning="share of insertions whose pull-out force at 20 mm exceeds all of the insertion's",
        relative_tolerance=1.0,
    ),
    Metric(
        name="pullout_over_insertion_most",
        unit="1",
        meaning="largest pull-out force at 20 mm as a share of the insertion force there",
        relative_tolerance=1.0,
    ),
    *(
        Metric(
            name=f"pullout_{name}_{share}_pct",
            unit="%",
            meaning=f"{text}, {which}",
            relative_tolerance=1.0,
        )
        for name, text in (
            ("shallower_peak", "largest pull-out force at 60 to 78 mm above that at 78 mm"),
            ("neighbour", "difference of the pull-out force from the next insertion's"),
        )
        for share, which in (("median", "median"), ("p90", "90th percentile"))
    ),
)
"""Of real liver itself: what could be known, and how far its yardstick is to be trusted."""
