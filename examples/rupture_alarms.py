"""Ruptures, as they happen
=========================

The identifier raises a rupture some milliseconds after the tissue ruptures; what it
estimates then is when and where that was.
"""

import matplotlib.pyplot as plt

from groundtruth import insert_needle
from identification import Identifier

TICK_s = 2e-3
END = 30_000  # ticks; the needle is through the gels

# A needle with a force sensor, and three gels.
run = insert_needle("stack-glove-constant", rate_hz=1.0 / TICK_s)
identifier = Identifier()
alarms = []
for depth_m, speed_m_s, force_N in zip(
    run.depth_m[:END], run.speed_m_s[:END], run.force_N[:END], strict=True
):
    estimate = identifier.update(depth_m, speed_m_s, force_N, TICK_s)
    if estimate.rupture is not None:
        alarms.append(estimate.rupture)

true_ruptures = [rupture for rupture in run.truth.ruptures if rupture.layer > 0]
figure, axes = plt.subplots(1, len(alarms), sharey=True)
for panel, alarm, rupture in zip(axes, alarms, true_ruptures, strict=True):
    alarm_s = alarm.alarm_s - TICK_s  # the first sample is at time zero
    delay_ms = 1e3 * (alarm_s - rupture.onset_s)
    print(f"layer {alarm.layer}: alarm {delay_ms:.0f} ms after the rupture began")

    around = abs(run.t_s - rupture.onset_s) < 0.25
    time_ms = 1e3 * (run.t_s[around] - rupture.onset_s)
    panel.plot(time_ms, run.force_N[around], lw=1)
    panel.axvspan(0.0, 1e3 * (rupture.end_s - rupture.onset_s), alpha=0.2)
    panel.axvline(delay_ms, color="tab:red")
    panel.set_title(f"layer {alarm.layer}")
    panel.set_xlabel("time [ms]")
axes[0].set_ylabel("axial force [N]")
figure.suptitle("shaded: the tissue ruptures; red: alarm")
plt.show()
