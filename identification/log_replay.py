"""A whole recording through the online identifier."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import Suspicion
from identification.config import MIXTURE, MixtureConfig, PublishedConfig
from identification.estimate import Estimate, LayerEstimate, SampleStatus
from identification.identifier import Identifier
from identification.published.offline import read_column


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """Online estimates of a recording.

    Attributes:
        t_s: Time stamps of the recording, shape (n,), read-only.
        estimates: One per row.
        contact_depths_m: Depth of the first contact as known at each row, nan before,
            shape (n,). The published method is given it.
        layers: Layers traversed, as known at the end.
        hints: Suspicions about signs and units, as text with advice; rejected rows.
    """

    t_s: Array
    estimates: tuple[Estimate, ...]
    contact_depths_m: Array
    layers: tuple[LayerEstimate, ...]
    hints: tuple[Suspicion, ...]


def replay(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    force_N: ArrayLike,
    speed_m_s: ArrayLike | None = None,
    config: MixtureConfig | PublishedConfig = MIXTURE,
    *,
    dt_s: ArrayLike | None = None,
    force_std_N: ArrayLike | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Replay:
    """Run the identifier over a recording, sample by sample.

    Rows that cannot be used (gaps, time running backwards) are reported in their
    estimate's status, not dropped. Where a clock may have been set, give ``dt_s``.
    Estimates, ruptures and layers are on the clock of ``t_s`` and count depth from the
    zero of ``depth_m``.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_m: Tip depth, growing into the tissue [m], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        speed_m_s: Rate of depth [m/s]; estimated from depth, see `Identifier.update`,
            if None.
        config: `MIXTURE`, `PUBLISHED` or a variant.
        dt_s: Time since the latest row that advanced [s], shape (n,), not positive for
            a row that does not; None to count from the latest stamp. The first one is
            not read.
        force_std_N: Standard deviation of the force's slow error [N], see
            `Identifier.update`.
        progress: Takes the fraction of the rows that is done.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    times_s = read_column("t_s", t_s)
    rows = len(times_s)
    depths_m = read_column("depth_m", depth_m, rows)
    forces_N = read_column("force_N", force_N, rows)
    # A stamp that is no number spoils its own row only.
    latest_s = np.fmax.accumulate(np.concatenate((times_s[:1], times_s[:-1])))
    steps_s = times_s - latest_s if dt_s is None else read_column("dt_s", dt_s, rows)
    forward_s = steps_s[1:200][steps_s[1:200] > 0.0]
    steps_s[: np.argmax(np.isfinite(times_s)) + 1] = (
        np.median(forward_s) if forward_s.size else 1e-3
    )
    speeds_m_s = None
    if speed_m_s is not None:
        speeds_m_s = read_column("speed_m_s", speed_m_s, rows)
    stds_N = repeat(0.0)
    if force_std_N is not None:
        stds_N = read_column("force_std_N", force_std_N, rows).tolist()
    identifier = Identifier(config)
    known_m = config.contact_depth_m if isinstance(config, PublishedConfig) else None
    estimates: list[Estimate] = []
    contacts_m: list[float | None] = []
    for row in zip(
        depths_m.tolist(),
        repeat(None) if speeds_m_s is None else speeds_m_s.tolist(),
        forces_N.tolist(),
        steps_s.tolist(),
        times_s.tolist(),
        stds_N,
        strict=False,
    ):
        estimates.append(identifier.update(*row))
        contacts_m.append(identifier.contact_depth_m if known_m is None else known_m)
        if len(estimates) % 10_000 == 0:
            progress(len(estimates) / rows)
    times_s.setflags(write=False)
    first_contacts_m = np.array(contacts_m, dtype=np.float64)  # None becomes nan
    contact_row = int(np.argmax(np.isfinite(first_contacts_m)))
    # Before contact a force far below zero is the zero of its sensor.
    counts = Counter(
        estimate.status
        for row, estimate in enumerate(estimates)
        if row >= contact_row or estimate.status is not SampleStatus.NEEDLE_PULLED
    )
    is_used = np.array([estimate.status.is_used for estimate in estimates])
    # A wrong unit may be why most rows were rejected.
    is_judged = is_used | (2 * np.count_nonzero(is_used) < rows)
    judged_m = np.where(is_judged, depths_m, np.nan)
    free_air_N = _find_free_air_level(first_contacts_m, forces_N)
    # Who reads a log reports a NaN or a late stamp.
    of_reader = (
        SampleStatus.OK,
        SampleStatus.NOT_FINITE,
        SampleStatus.TIME_NOT_FORWARD,
    )
    reports = [
        Suspicion(f"{count} rows: {status.value}")
        for status, count in counts.items()
        if status not in of_reader
    ]
    return Replay(
        t_s=times_s,
        estimates=tuple(estimates),
        contact_depths_m=first_contacts_m,
        layers=identifier.layers,
        hints=(*_suspect(judged_m, forces_N - free_air_N, speeds_m_s), *reports),
    )


def _find_free_air_level(contact_depths_m: Array, force_N: Array) -> float:
    """Return what a force sensor reads before contact [N]: an offset has no sign.

    It is the median of the first tenth of the rows before contact, since a force of the
    wrong sign lets contact be found late; zero where a log begins in contact.

    Args:
        contact_depths_m: Of the first contact as known at each row, nan before.
        force_N: Axial force.
    """
    is_known = np.isfinite(contact_depths_m)
    before = int(np.argmax(is_known)) if is_known.any() else len(is_known)
    first_N = force_N[: before // 10]
    first_N = first_N[np.isfinite(first_N)]
    return float(np.median(first_N)) if first_N.size else 0.0


def _suspect(
    depth_m: Array, force_N: Array, speed_m_s: Array | None
) -> Iterator[Suspicion]:
    """Yield suspicions about signs and units of columns, shape (n,), if any.

    Args:
        depth_m: Tip depth; nan in rows that are not judged.
        force_N: Axial force, from its level in free air.
        speed_m_s: Rate of depth, if there is one.
    """
    finite_m = depth_m[np.isfinite(depth_m)]
    span_m = float(np.ptp(finite_m)) if finite_m.size else 0.0
    if span_m > 1.0:  # no needle goes deeper
        yield Suspicion(
            f"depth spans {span_m:.3g} m; is it in millimetres?",
            "Give `depth_m` in metres.",
        )
    if span_m < 1e-3:
        yield Suspicion(
            f"depth moves by {span_m * 1e3:.3g} mm only; there is nothing to identify",
            "Give `depth_m` in metres, of a recording that has an insertion.",
        )
        return
    change_m = np.diff(depth_m, prepend=depth_m[:1])
    is_good = np.isfinite(change_m) & np.isfinite(force_N)
    is_deepest = depth_m >= np.fmax.accumulate(depth_m)
    is_insertion = is_good & is_deepest & (change_m > 0.0)
    insertion_m = change_m[is_insertion]
    work_J = float(force_N[is_insertion] @ insertion_m)
    if work_J < -0.02 * insertion_m.sum():  # a mean force of -20 mN
        yield Suspicion(
            "the force is negative while the needle goes in; it must be positive when "
            "tissue pushes back",
            "Negate `force_N`.",
        )
    fallen_m = float(finite_m[0] - finite_m.min())
    if fallen_m > 0.7 * span_m and np.ptp(force_N[is_good]) > 0.0:
        yield Suspicion(
            "depth falls before it rises; it must grow into the tissue",
            "Negate `depth_m`, unless the recording begins with a withdrawal.",
        )
    if speed_m_s is None:
        return
    is_good &= np.isfinite(speed_m_s)
    if change_m[is_good] @ speed_m_s[is_good] < 0.0:
        yield Suspicion(
            "speed has the sign opposite to the change of depth",
            "Negate `speed_m_s` or `depth_m`, or leave the speed out.",
        )
