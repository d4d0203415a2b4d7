"""Layers as a table for people, in millimetres."""

from identification.command.log_clock import LogClock
from identification.command.result import IdentificationResult
from identification.estimate import LayerEstimate

HEADER = (
    "layer",
    "from mm",
    "thick mm",
    "rupture s",
    "alarm s",
    "drop N",
    "K N/m",
    "friction N",
    "B d Ns/m",
    "B Ns/m2",
)
"""Of the columns."""


def layer_table(result: IdentificationResult) -> str:
    """Text table, one line per layer; `?` marks what the data do not identify."""
    if not result.layers:
        return "no layer was left: no rupture found\n"
    lines = [HEADER, *(layer_cells(layer, result.clock) for layer in result.layers)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
    return "".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) + "\n"
        for line in lines
    )


def layer_cells(layer: LayerEstimate, clock: LogClock) -> tuple[str, ...]:
    """The line of a layer.

    Args:
        layer: As known at the end.
        clock: From the layer's times to the log's clock.
    """
    rupture = layer.rupture
    product = layer.friction_N / max(rupture.speed_m_s, 1e-9)
    unsure = "" if layer.friction_identified else "?"
    return (
        str(layer.layer),
        f"{1e3 * layer.start_depth_m:.1f}",
        f"{1e3 * layer.thickness_m:.1f}",
        f"{clock.at(rupture.time_s):.2f}",
        f"{clock.at(rupture.alarm_s):.2f}",
        _with_std(layer.force_drop_N, layer.force_drop_std_N, 2),
        _with_std(layer.stiffness_N_per_m, layer.stiffness_std_N_per_m, 1)
        + ("" if layer.stiffness_identified else "?"),
        _with_std(layer.friction_N, layer.friction_std_N, 3) + unsure,
        f"{product:.0f}{unsure}",
        f"{layer.friction_Ns_per_m2:.0f}{unsure}",
    )


def _with_std(value: float, std: float | None, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text}±{std:.{digits}f}"
