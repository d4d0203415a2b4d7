"""Draws the offline fit of one run: Figures 2 and 3."""

from benchmarks.charts.offline_chart import offline_chart
from benchmarks.charts.paper_figures import OFFLINE_PANELS
from benchmarks.charts.sketchbook import Sketchbook
from benchmarks.drawing import Fact
from benchmarks.methods.offline_fit import offline_metrics
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal


def draw_offline(book: Sketchbook, signal: NeedleSignal, truth: InsertionTruth) -> None:
    """Both models on the F/T reading, where the paper shows that scenario so."""
    if book.job.benchmark not in OFFLINE_PANELS:
        return
    figure, panel = OFFLINE_PANELS[book.job.benchmark]
    found = offline_metrics(signal, truth)
    name = f"`{book.job.benchmark}`: RMSE of the insertion [N]"
    said = "ML below KV"
    book.add(
        offline_chart(book.title(figure, panel, "models fitted offline"), signal, truth),
        "offline",
        figure=figure,
        panel=panel,
        alt="F/T reading with the reconstructions of the Kelvin-Voigt and the multi-layer model; "
        "below, what each leaves",
        caption="Broad and pale the reading, thin the two models with layers and ruptures given; "
        "below what each leaves, of which peaks where a layer gives way may leave the panel. "
        "RMSE from first contact to the deepest point.",
        facts=(
            Fact(
                what=name,
                paper=said,
                here=(
                    ("Kelvin-Voigt, here", f"{found['offline_rmse_kv_N']:.3f}"),
                    ("multi-layer, here", f"{found['offline_rmse_ml_N']:.3f}"),
                ),
            ),
        ),
    )
